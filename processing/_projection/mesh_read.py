"""Triangle meshes and point clouds from files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from acquisition import DataError, MeshFile, read_mesh_file
from processing._projection.manifold import wind_alike

Double = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int32]

_CLOUDS = (".ply", ".xyz")
# Normals of a file are off unit length by their digits only; colours are not unit vectors.
_UNIT_TOLERANCE = 0.02


@dataclass(frozen=True, eq=False)
class Geometry:
    """A triangle mesh or a point cloud, in the axes and the unit of its file.

    Parameters
    ----------
    vertices
        ``(V, 3)`` float64, finite.
    faces
        ``(F, 3)`` int32 vertex numbers, counter-clockwise seen from outside; None for points.
    normals
        ``(V, 3)`` float64 unit vectors that came with the points, or None.
    warnings
        What the reader should know, a line each.

    Raises
    ------
    DataError
        If there is no vertex, a mesh has no face, a vertex is not finite, or a face names a vertex
        that is not there.
    """

    vertices: Double
    faces: Whole | None = None
    normals: Double | None = None
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, np.float64)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not len(vertices):
            raise DataError(f"vertices of shape {vertices.shape}, expected (V, 3) with V above 0")
        finite = np.isfinite(vertices).all(axis=1)
        if not finite.all():
            raise DataError(
                f"vertex {int(finite.argmin())} is {vertices[finite.argmin()].tolist()}, not "
                "finite: mend the mesh"
            )
        object.__setattr__(self, "vertices", vertices)
        if self.faces is None:
            return
        faces = np.asarray(self.faces)
        if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
            raise DataError(f"faces of shape {faces.shape}, expected (F, 3) with F above 0")
        if faces.min() < 0 or faces.max() >= len(vertices):
            wrong = int(((faces < 0) | (faces >= len(vertices))).any(axis=1).argmax())
            raise DataError(
                f"face {wrong} names a vertex that is not there, the mesh has {len(vertices)}"
            )
        object.__setattr__(self, "faces", np.ascontiguousarray(faces, np.int32))


def read_geometry(path: str | Path) -> Geometry:
    """Read a triangle mesh or a point cloud.

    Parameters
    ----------
    path
        A mesh as OBJ, PLY, STL, GLB or OFF, polygons and triangle strips being cut into triangles;
        a point cloud as PLY without faces or as XYZ, a text of ``x y z`` or ``x y z nx ny nz``
        lines.

    Returns
    -------
    Geometry
        Vertices of a mesh that lie in one place are one, so that normals blend over the seams of
        textures and between the loose faces of an STL; those that no face uses are left out. Faces
        that wind against their neighbours are turned round and told; edges of more than two faces
        are told. Points that are not finite, as scanners write for a miss, are left out and told.

    Raises
    ------
    MissingPathError
        If there is no such file.
    DataError
        If it is of another kind, damaged, truncated, or see `Geometry`.
    """
    mesh = read_mesh_file(path)
    try:
        if mesh.faces is None:
            if Path(path).suffix.lower() not in _CLOUDS:
                raise DataError("the mesh has no faces: point clouds are read from .ply and .xyz")
            return _cloud(mesh)
        return _mesh(mesh, mesh.faces)
    except DataError as error:
        raise DataError(f"{path}: {error}") from error


def _mesh(mesh: MeshFile, faces: npt.NDArray[Any]) -> Geometry:
    # Here numbers beyond 32 bits are found.
    checked = Geometry(mesh.vertices, faces)
    joined, corners = _joined(checked.vertices, faces)
    corners, turned, crowded = wind_alike(corners)
    warnings = list(mesh.warnings)
    if crowded:
        warnings.append(
            f"edges where more than two faces meet (no manifold): {crowded}; it is drawn as it is"
        )
    if turned:
        warnings.append(f"faces turned round as they wind against their neighbours: {turned}")
    return Geometry(joined, corners, warnings=tuple(warnings))


def _joined(vertices: Double, faces: npt.NDArray[np.int64]) -> tuple[Double, Whole]:
    """Make one vertex of those in one place, and leave out those that no face uses."""
    used = np.zeros(len(vertices), np.bool_)
    used[faces] = True
    order = np.lexsort(vertices.T)
    order = order[used[order]]
    ordered = vertices[order]
    new = np.concatenate([[True], (ordered[1:] != ordered[:-1]).any(axis=1)])
    # The first of each place in the order of the file keeps its turn: near in the file, near in
    # memory.
    first = np.minimum.reduceat(order, np.flatnonzero(new))
    kept = np.sort(first)
    number = np.zeros(len(vertices), np.int32)
    number[order] = np.searchsorted(kept, first)[np.cumsum(new) - 1]
    return vertices[kept], number[faces]


def _cloud(mesh: MeshFile) -> Geometry:
    points = mesh.vertices
    finite = np.isfinite(points).all(axis=1)
    warnings = []
    if not finite.all():
        warnings.append(f"points left out as not finite: {int((~finite).sum())}")
    if not finite.any():
        raise DataError("the point cloud holds no finite point")
    normals = None if mesh.normals is None else mesh.normals[finite]
    if normals is not None:
        # Before their length, which would overflow.
        short = (np.abs(normals) < 2).all(axis=1, keepdims=True)
        length = np.linalg.norm(np.where(short, normals, 0), axis=1)
        off = ~(np.abs(length - 1) < _UNIT_TOLERANCE)
        if off.any():
            warnings.append(
                f"of {len(off)} points {int(off.sum())} come with a normal that is no unit vector "
                "(or a colour): all normals are fitted anew"
            )
            normals = None
    return Geometry(points[finite], None, normals, tuple(warnings))
