"""A triangle mesh as an object on the board."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
import numpy.typing as npt

from acquisition import DataError, read_mesh_file
from simulator._shapes.body import BodyHits
from simulator._shapes.bvh import TriangleTree

Array = npt.NDArray[np.float64]
Faces = npt.NDArray[np.int64]

SUFFIXES = (".obj", ".ply", ".stl")


@dataclass(frozen=True, eq=False)
class MeshBody:
    """A mesh in its place, seen from all sides.

    Parameters
    ----------
    vertices_mm
        ``(V, 3)`` in the house frame.
    faces
        ``(F, 3)`` numbers of vertices.
    smooth
        True blends the normals of the faces around each vertex over the faces, weighted by the
        angle of each face there; False leaves every face flat.
    name
        Said in messages: the file, if there is one.

    Raises
    ------
    DataError
        If there are no faces, a vertex is not finite, a face names a vertex that is not there, or
        a face has no area.
    """

    vertices_mm: Array
    faces: Faces
    smooth: bool = True
    name: str = "mesh"

    def __post_init__(self) -> None:
        vertices, faces = np.asarray(self.vertices_mm), np.asarray(self.faces)
        if vertices.ndim != 2 or vertices.shape[1:] != (3,):
            raise DataError(f"{self.name}: vertices of shape {vertices.shape}, wanted (V, 3)")
        if faces.size == 0:
            raise DataError(f"{self.name}: the mesh has no faces: is it a point cloud?")
        if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
            raise DataError(f"{self.name}: faces are not triples of vertex numbers")
        bad = ~np.isfinite(vertices).all(axis=1)
        if bad.any():
            raise DataError(f"{self.name}: vertex {int(bad.argmax())} is not finite; mend the mesh")
        out = ((faces < 0) | (faces >= len(vertices))).any(axis=1)
        if out.any():
            raise DataError(
                f"{self.name}: face {int(out.argmax())} names a vertex that is not there, the mesh "
                f"has {len(vertices)}"
            )
        object.__setattr__(self, "vertices_mm", np.ascontiguousarray(vertices, np.float64))
        object.__setattr__(self, "faces", np.ascontiguousarray(faces, np.int64))
        flat = np.linalg.norm(self._crosses, axis=1) == 0
        if flat.any():
            raise DataError(
                f"{self.name}: {int(flat.sum())} of {len(flat)} faces have no area, the first is "
                f"face {int(flat.argmax())}; remove degenerate faces"
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
        """Read a mesh file and rest it on the board in the middle of the field.

        Parameters
        ----------
        path
            OBJ, PLY or STL.
        radius_mm
            The mesh is scaled until its footprint reaches just so far from the origin.
        turn_deg
            Angles of rotation about the x axis, then y, then z, before it is scaled.
        smooth
            See the class. The corners of an STL file are joined where they are equal.

        Returns
        -------
        MeshBody
            The middle of its extent in x and y over the origin, its lowest point at z = 0.

        Raises
        ------
        MissingPathError
            If there is no such file.
        DataError
            If the file cannot be understood, or see the class.
        """
        vertices, faces = read_triangles(path)
        if not (math.isfinite(radius_mm) and radius_mm > 0):
            raise DataError(f"{path}: a radius of {radius_mm} mm is not a positive length")
        if len(turn_deg) != 3 or not all(math.isfinite(angle) for angle in turn_deg):
            raise DataError(f"{path}: a turn of {turn_deg} is not three angles in degrees")
        # First as it comes: it names what is wrong in the file's own terms.
        cls(vertices, faces, smooth, str(path))
        turned = vertices @ _rotation(turn_deg).T
        low, high = turned.min(axis=0), turned.max(axis=0)
        middle = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
        moved = turned - middle
        # Vertices that no face uses count too: they are part of the file's extent.
        scale = radius_mm / float(np.hypot(moved[:, 0], moved[:, 1]).max())
        return cls(moved * scale, faces, smooth, str(path))

    @property
    def radius_mm(self) -> float:
        """Radius around the origin that holds the whole footprint."""
        return float(np.hypot(self.vertices_mm[:, 0], self.vertices_mm[:, 1]).max())

    @property
    def top_mm(self) -> float:
        """Height of the highest vertex."""
        return float(self.vertices_mm[:, 2].max())

    @cached_property
    def tree(self) -> TriangleTree:
        """The triangles, ready for searching."""
        return TriangleTree.grow(self.vertices_mm[self.faces])

    @cached_property
    def face_normals(self) -> Array:
        """``(F, 3)`` unit normals of the faces, corners counterclockwise."""
        crosses = self._crosses
        normals: Array = crosses / np.linalg.norm(crosses, axis=1, keepdims=True)
        return normals

    @cached_property
    def vertex_normals(self) -> Array:
        """``(V, 3)`` unit normals, the mean over the faces by their angle at the vertex.

        The weights of Thuermer and Wuethrich (Computing vertex normals from polygonal facets,
        1998): they do not depend on how a flat part is cut into triangles. (0, 0, 1) where no
        face is, or where the faces cancel out.
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
        known = length > 1e-9
        return np.where(known, total / np.where(known, length, 1.0), [0.0, 0.0, 1.0])

    def inside(self, x_mm: Array, y_mm: Array) -> npt.NDArray[np.bool_]:
        """Return which positions of the board the mesh covers, seen straight from above."""
        x, y = np.broadcast_arrays(x_mm, y_mm)
        covered = np.zeros(x.shape, np.bool_)
        near = np.hypot(x, y) <= self.radius_mm
        origins = np.stack([x[near], y[near], np.full(near.sum(), self.top_mm + 1.0)], axis=-1)
        down = np.broadcast_to([0.0, 0.0, -1.0], origins.shape)
        covered[near] = self.tree.blocked(origins, down, math.inf)
        return covered

    def trace(self, origins_mm: Array, directions: Array) -> BodyHits:
        """Find where rays first meet the mesh.

        Parameters
        ----------
        origins_mm, directions
            ``(..., 3)``, or shapes that broadcast to one another.

        Returns
        -------
        BodyHits
            Points to rounding. A face is seen from both sides: its normal is turned to the side
            that the ray came from, and a smooth normal goes with its face.
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
        """Return the tree; its ``blocked`` finds what stands before a lamp."""
        return self.tree

    @property
    def _crosses(self) -> Array:
        a, b, c = (self.vertices_mm[self.faces[:, i]] for i in range(3))
        crosses: Array = np.cross(b - a, c - a)
        return crosses


def read_triangles(path: Path | str) -> tuple[Array, Faces]:
    """Read the triangles of a mesh file, polygons cut into triangles.

    Parameters
    ----------
    path
        OBJ, PLY or STL.

    Returns
    -------
    vertices, faces
        ``(V, 3)`` in the units and axes of the file, ``(F, 3)``.

    Raises
    ------
    MissingPathError
        If there is no such file.
    DataError
        If the file is not one of these, or is damaged.
    """
    file = Path(path)
    if file.suffix.lower() not in SUFFIXES:
        raise DataError(f"{file}: a mesh is read from {', '.join(SUFFIXES)}, not {file.suffix!r}")
    mesh = read_mesh_file(file)
    faces = np.zeros((0, 3), np.int64) if mesh.faces is None else mesh.faces
    if file.suffix.lower() == ".stl":
        # Each facet has vertices of its own: joined, or no normal could be blended.
        vertices, places = np.unique(mesh.vertices, axis=0, return_inverse=True)
        return vertices, places.reshape(-1)[faces]
    return mesh.vertices, faces


def _rotation(turn_deg: Sequence[float]) -> Array:
    turn = np.eye(3)
    for axis, angle in enumerate(np.radians(turn_deg)):
        about = np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        about[i, i] = about[j, j] = math.cos(angle)
        about[i, j], about[j, i] = -math.sin(angle), math.sin(angle)
        turn = about @ turn
    return turn
