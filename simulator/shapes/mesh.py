"""A triangle mesh as an object on the board."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np

from acquisition import DataError
from acquisition.mesh_files import read_mesh_file
from rig import short_repr
from rig.arrays import Bool, Float64, Int64
from simulator.shapes.body import BodyHits
from simulator.shapes.bvh import TriangleTree
from simulator.shapes.ranges import check_length

SUFFIXES = (".obj", ".ply", ".stl")


@dataclass(frozen=True, eq=False)
class MeshBody:
    """A mesh in its final position; its faces are visible from both sides.

    Parameters
    ----------
    vertices_mm
        ``(V, 3)`` vertices in the house frame.
    faces
        ``(F, 3)`` indices of vertices.
    smooth
        If True, normals are interpolated between the vertices; a vertex normal is the mean over its
        faces, weighted by their angles. If False, faces are flat.
    name
        Name in messages: the file, if there is one.

    Raises
    ------
    DataError
        If there are no faces, a vertex is not finite, a face refers to a vertex that does not
        exist, or a face has no area.
    """

    vertices_mm: Float64
    faces: Int64
    smooth: bool = True
    name: str = "mesh"

    __repr__ = short_repr

    def __post_init__(self) -> None:
        vertices, faces = np.asarray(self.vertices_mm), np.asarray(self.faces)
        if vertices.ndim != 2 or vertices.shape[1:] != (3,):
            raise DataError(f"{self.name}: vertices have shape {vertices.shape}, expected (V, 3)")
        if faces.size == 0:
            raise DataError(f"{self.name}: the mesh has no faces: is it a point cloud?")
        if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
            raise DataError(f"{self.name}: faces are not triples of vertex indices")
        bad = ~np.isfinite(vertices).all(axis=1)
        if bad.any():
            raise DataError(
                f"{self.name}: vertex {int(bad.argmax())} is not finite; repair the mesh"
            )
        out = ((faces < 0) | (faces >= len(vertices))).any(axis=1)
        if out.any():
            raise DataError(
                f"{self.name}: face {int(out.argmax())} refers to a vertex that does not exist; "
                f"the mesh has {len(vertices)} vertices"
            )
        object.__setattr__(self, "vertices_mm", np.ascontiguousarray(vertices, np.float64))
        object.__setattr__(self, "faces", np.ascontiguousarray(faces, np.int64))
        flat = np.linalg.norm(self._crosses, axis=1) == 0
        if flat.any():
            raise DataError(
                f"{self.name}: {int(flat.sum())} of {len(flat)} faces have no area, the first one "
                f"is face {int(flat.argmax())}; remove degenerate faces"
            )

    @classmethod
    def read(
        cls,
        path: Path | str,
        *,
        radius_mm: float,
        turn_deg: Sequence[float] = (0.0, 0.0, 0.0),
        smooth: bool = True,
    ) -> Self:
        """Read a mesh file and place it on the board in the middle of the field.

        Parameters
        ----------
        path
            OBJ, PLY or STL file.
        radius_mm
            Radius of the footprint around the origin, to which the mesh is scaled.
        turn_deg
            Angles of rotation about the x axis, then y, then z, before scaling.
        smooth
            See the class. Equal vertices of an STL file are merged.

        Returns
        -------
        MeshBody
            Mesh whose extent in x and y is centred on the origin, with its lowest point at z = 0.

        Raises
        ------
        MissingPathError
            If the file does not exist.
        DataError
            If the file cannot be parsed, or for the reasons listed for the class.
        """
        vertices, faces = read_triangles(path)
        check_length(str(path), radius_mm=radius_mm)
        if len(turn_deg) != 3 or not all(math.isfinite(angle) for angle in turn_deg):
            raise DataError(f"{path}: turn_deg is {turn_deg}, it must be three angles in degrees")
        # Check the mesh before it is moved, so that messages refer to the values in the file.
        cls(vertices, faces, smooth, str(path))
        turned = vertices @ _rotation(turn_deg).T
        low, high = turned.min(axis=0), turned.max(axis=0)
        middle = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
        moved = turned - middle
        # Vertices that no face uses are part of the extent, too.
        scale = radius_mm / float(np.hypot(moved[:, 0], moved[:, 1]).max())
        return cls(moved * scale, faces, smooth, str(path))

    @property
    def radius_mm(self) -> float:
        """Radius around the origin that contains the footprint."""
        return float(np.hypot(self.vertices_mm[:, 0], self.vertices_mm[:, 1]).max())

    @property
    def top_mm(self) -> float:
        """Height of the highest vertex."""
        return float(self.vertices_mm[:, 2].max())

    @cached_property
    def tree(self) -> TriangleTree:
        """Search tree of the triangles."""
        return TriangleTree.grow(self.vertices_mm[self.faces])

    @cached_property
    def face_normals(self) -> Float64:
        """``(F, 3)`` unit normals of the faces; corners are counterclockwise."""
        crosses = self._crosses
        return np.asarray(crosses / np.linalg.norm(crosses, axis=1, keepdims=True))

    @cached_property
    def vertex_normals(self) -> Float64:
        """``(V, 3)`` unit normals, the mean over the faces weighted by their angle at the vertex.

        These weights (Thuermer and Wuethrich, Computing vertex normals from polygonal facets, 1998)
        do not depend on the triangulation of a flat part. The normal is (0, 0, 1) if a vertex has
        no faces or their normals cancel out.
        """
        total = np.zeros_like(self.vertices_mm)
        corners = self.vertices_mm[self.faces]
        for c in range(3):
            to_next = corners[:, (c + 1) % 3] - corners[:, c]
            to_last = corners[:, (c + 2) % 3] - corners[:, c]
            sine = np.linalg.norm(np.cross(to_next, to_last), axis=1)
            angle = np.arctan2(sine, (to_next * to_last).sum(axis=1))
            for axis in range(3):
                total[:, axis] += np.bincount(
                    self.faces[:, c], angle * self.face_normals[:, axis], len(total)
                )
        length = np.linalg.norm(total, axis=1, keepdims=True)
        defined = length > 1e-9
        return np.where(defined, total / np.where(defined, length, 1.0), [0.0, 0.0, 1.0])

    def inside(self, x_mm: Float64, y_mm: Float64) -> Bool:
        """Return which positions of the board the mesh covers, seen vertically from above."""
        x, y = np.broadcast_arrays(x_mm, y_mm)
        covered = np.zeros(x.shape, np.bool_)
        near = np.hypot(x, y) <= self.radius_mm
        origins = np.stack([x[near], y[near], np.full(near.sum(), self.top_mm + 1.0)], axis=-1)
        down = np.broadcast_to([0.0, 0.0, -1.0], origins.shape)
        covered[near] = self.tree.blocked(origins, down, math.inf)
        return covered

    def trace(self, origins_mm: Float64, directions: Float64) -> BodyHits:
        """Find the first hits of rays on the mesh.

        Parameters
        ----------
        origins_mm, directions
            ``(..., 3)`` arrays that broadcast against each other.

        Returns
        -------
        BodyHits
            Hits, to rounding error. A face is visible from both sides: its normal, also a smooth
            one, is flipped to the side from which the ray arrives.
        """
        origins, directions = np.broadcast_arrays(origins_mm, directions)
        shape = origins.shape[:-1]
        origins, directions = origins.reshape(-1, 3), directions.reshape(-1, 3)
        t, weights, face = self.tree.closest(origins, directions)
        hit = face >= 0
        points, normals = np.zeros(origins.shape), np.zeros(origins.shape)
        points[hit] = origins[hit] + t[hit, None] * directions[hit]
        seen = self.face_normals[face[hit]]
        away = (seen * directions[hit]).sum(axis=1) > 0
        if self.smooth:
            corners = self.vertex_normals[self.faces[face[hit]]]
            seen = (corners * weights[hit, :, None]).sum(axis=1)
            seen /= np.maximum(np.linalg.norm(seen, axis=1, keepdims=True), 1e-300)
        normals[hit] = np.where(away[:, None], -seen, seen)
        return BodyHits(points.reshape(*shape, 3), normals.reshape(*shape, 3), hit.reshape(shape))

    def shadow_caster(self, step_mm: float) -> TriangleTree:
        """Return the tree, whose ``blocked`` finds blocked shadow rays."""
        return self.tree

    @property
    def _crosses(self) -> Float64:
        a, b, c = (self.vertices_mm[self.faces[:, i]] for i in range(3))
        return np.cross(b - a, c - a)


def read_triangles(path: Path | str) -> tuple[Float64, Int64]:
    """Read the triangles of a mesh file; polygons are triangulated.

    Parameters
    ----------
    path
        OBJ, PLY or STL file.

    Returns
    -------
    vertices, faces
        ``(V, 3)`` vertices in the units and axes of the file, ``(F, 3)`` indices.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If the file has another format or is damaged.
    """
    file = Path(path)
    if file.suffix.lower() not in SUFFIXES:
        raise DataError(
            f"{file}: the suffix of a mesh file must be {', '.join(SUFFIXES)}, not {file.suffix!r}"
        )
    mesh = read_mesh_file(file)
    faces = np.zeros((0, 3), np.int64) if mesh.faces is None else mesh.faces
    if file.suffix.lower() == ".stl":
        # Each facet has its own vertices; they are merged so that normals can be interpolated.
        vertices, places = np.unique(mesh.vertices, axis=0, return_inverse=True)
        return vertices, places.reshape(-1)[faces]
    return mesh.vertices, faces


def _rotation(turn_deg: Sequence[float]) -> Float64:
    turn = np.eye(3)
    for axis, angle in enumerate(np.radians(turn_deg)):
        about = np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        about[i, i] = about[j, j] = math.cos(angle)
        about[i, j], about[j, i] = -math.sin(angle), math.sin(angle)
        turn = about @ turn
    return turn
