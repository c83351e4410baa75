"""Watertight solids from surfaces."""

from __future__ import annotations

import math

import numpy as np

from acquisition import DataError
from processing.meshes.mesh import Mesh
from processing.meshes.rim import rim
from rig import check_type
from rig.arrays import Float32, Int32, Int64, Intp

# Thickness of a base below the lowest point, as a share of the width.
_THICKNESS = 0.02
# Fans around one point move apart by this share of the way to their neighbours: readers of files
# without indices, such as STL, join vertices in the same place.
_APART = 0.01


def solid_mesh(mesh: Mesh, base: float | None = None) -> Mesh:
    """Close a surface to a solid, for printing and CAD: walls down to a flat base.

    The base is the surface itself, seen from below and moved into a plane of constant z. Where the
    surface is in several parts, each becomes a solid of its own on the same plane. Parts that touch
    at one vertex only get a vertex each, 1 % of an edge away from it, so that every edge has
    exactly two triangles, also in files that hold no indices.

    Parameters
    ----------
    mesh
        A surface that is seen from +Z, for example of `height_mesh`.
    base
        Thickness of the base below the lowest point, in the unit of the mesh; the default is 2 % of
        the longer side.

    Returns
    -------
    Mesh
        The solid, without vertex normals: one vertex belongs to the surface and to a wall. Below
        the surface, colours are their mean.

    Raises
    ------
    DataError
        If the base is not a positive length, or an edge of the mesh belongs to three triangles.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, height_mesh, integrate, solid_mesh
    >>> y, x = np.mgrid[1:-1:5j, -1:1:5j]
    >>> bowl = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]))
    >>> solid = solid_mesh(height_mesh(integrate(bowl, pixel_mm=0.5)), base=1.0)
    >>> solid.vertices.shape, solid.faces.shape
    ((50, 3), (96, 3))
    """
    check_type("mesh", mesh, Mesh, "height_mesh(height_map) returns one")
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    thickness = _THICKNESS * float((high - low)[:2].max()) if base is None else base
    if not (math.isfinite(thickness) and thickness > 0):
        raise DataError(f"a base of {thickness} {mesh.unit} is not a positive thickness")
    faces, copied, edges = _separated(mesh.faces, len(mesh.vertices))
    top = _moved_apart(mesh.vertices[copied], faces, copied)
    bottom = top.copy()
    bottom[:, 2] = low[2] - np.float32(thickness)
    count = len(top)
    start, end = edges.astype(np.int32).T
    walls = [[end, start, start + count], [end, start + count, end + count]]
    sides = [np.stack(corners, axis=1) for corners in walls]
    closed = np.concatenate([faces, faces[:, ::-1] + np.int32(count), *sides])
    colours = places = None
    if mesh.colours is not None:
        painted = mesh.colours[copied]
        below = np.rint(painted.mean(axis=0)).astype(np.uint8)
        colours = np.concatenate([painted, np.broadcast_to(below, painted.shape)])
    if mesh.places is not None:
        places = np.concatenate([mesh.places[copied]] * 2)
    return Mesh(np.concatenate([top, bottom]), closed, None, mesh.unit, colours, places)


def _moved_apart(vertices: Float32, faces: Int32, copied: Intp) -> Float32:
    """Return the vertices, those in one place a little closer to their neighbours."""
    shared = np.bincount(copied)[copied] > 1
    touching = faces[shared[faces].any(axis=1)]
    places = np.repeat(vertices[touching].mean(axis=1), 3, axis=0)
    fans = np.maximum(np.bincount(touching.ravel(), minlength=len(vertices)), 1)
    moved = vertices.copy()
    for axis in range(3):
        sums = np.bincount(touching.ravel(), places[:, axis], minlength=len(vertices))
        towards = sums / fans - vertices[:, axis]
        moved[shared, axis] += (_APART * towards)[shared].astype(np.float32)
    return moved


def _separated(faces: Int32, count: int) -> tuple[Int32, Intp, Int64]:
    """Give each fan of triangles around a vertex of the rim a vertex of its own.

    Returns
    -------
    faces
        ``(F, 3)`` int32 indices of the new vertices.
    copied
        The old vertex of each new one; the first ``count`` are the old ones.
    edges
        ``(E, 2)`` the rim of the new faces.
    """
    edges = rim(faces, count)
    shared = np.flatnonzero(np.bincount(edges[:, 0], minlength=count) > 1)
    if not len(shared):
        return faces, np.arange(count), edges
    copied = list(range(count))
    faces = faces.copy()
    touched = np.flatnonzero(np.isin(faces, shared).any(axis=1))
    fans: dict[int, list[tuple[int, int, int]]] = {int(vertex): [] for vertex in shared}
    for face in touched:
        for corner in range(3):
            vertex = int(faces[face, corner])
            if vertex in fans:
                after, before = faces[face, (corner + 1) % 3], faces[face, (corner + 2) % 3]
                fans[vertex].append((int(after), int(before), int(face)))
    for vertex, around in fans.items():
        following = {after: (before, face) for after, before, face in around}
        for first in sorted(set(following) - {before for _, before, _ in around})[1:]:
            step = following.get(first)
            while step is not None:
                before, member = step
                faces[member] = np.where(faces[member] == vertex, len(copied), faces[member])
                step = following.get(before)
            copied.append(vertex)
    return faces, np.asarray(copied), rim(faces, len(copied))
