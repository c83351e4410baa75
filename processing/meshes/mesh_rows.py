"""Meshes of which parts are read, one after the other: as a whole they take much memory."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from acquisition import MapRows
from acquisition.files import rows_in_bands
from processing.meshes.face_kernels import KINDS, faces_of_kind, kinds_of_triangles
from processing.meshes.mesh import Mesh, no_triangle
from processing.stages.stage import NormalRows
from processing.surface.height_map import HeightMap
from rig.arrays import Float32, Generic, Integer, UInt8

# Bytes of a pixel with its points and triangles, and of a band.
_PIXEL, _BAND = 150, 1 << 26
# Number of vertices, faces, or lines of a text, that are encoded at once.
_ROWS = 1 << 16

Vertices = tuple[Float32, Float32 | None, UInt8 | None]


@dataclass(frozen=True, eq=False)
class MeshRows:
    """A triangle mesh in parts.

    Parameters
    ----------
    unit
        Unit of the vertices.
    vertex_count, face_count
        Number of vertices and of triangles.
    normals, colours
        Whether the vertices have normals and colours.
    vertices
        Parts of the vertices: points ``(N, 3)``, their normals and their colours.
    faces
        Parts of the triangles: numbers of their vertices ``(N, 3)``.
    facets
        Parts of the triangles: points of their corners ``(N, 3, 3)``.
    """

    unit: str
    vertex_count: int
    face_count: int
    normals: bool
    colours: bool
    vertices: Iterable[Vertices]
    faces: Iterable[Integer]
    facets: Iterable[Float32]


def rows_of_mesh(mesh: Mesh) -> MeshRows:
    """Return the parts of a mesh in memory."""
    normals, colours = mesh.normals, mesh.colours
    return MeshRows(
        mesh.unit,
        len(mesh.vertices),
        len(mesh.faces),
        normals is not None,
        colours is not None,
        (
            (
                mesh.vertices[part],
                None if normals is None else normals[part],
                None if colours is None else colours[part],
            )
            for part in rows_of_table(mesh.vertices)
        ),
        (mesh.faces[part] for part in rows_of_table(mesh.faces)),
        (mesh.vertices[mesh.faces[part]] for part in rows_of_table(mesh.faces)),
    )


def rows_of_table(table: Generic) -> Iterator[slice]:
    """Yield the rows of a table in parts."""
    for begin in range(0, len(table), _ROWS):
        yield slice(begin, begin + _ROWS)


def complete_mesh(
    surface: HeightMap, normals: NormalRows | None, colours: MapRows | None
) -> MeshRows:
    """Return the complete mesh of a surface of which rows are read.

    It has a section for each kind of triangle. The kinds of each square of four pixels are kept in
    memory, one byte per pixel. The parameters are those of `write_mesh`.

    Raises
    ------
    DataError
        If the surface contains no triangle.
    """
    height, width = surface.mask.shape
    bands = rows_in_bands(height, _PIXEL * width, _BAND, least=2)
    kinds = _kinds(surface, bands)
    count = sum(int(np.count_nonzero(kinds & (1 << kind))) for kind in range(KINDS))
    if not count:
        raise no_triangle()
    per_row = np.count_nonzero(surface.mask, axis=1)
    first = np.cumsum(per_row) - per_row

    def faces(rows: slice, kind: int, begin: int) -> Integer:
        both = _both(surface, rows)
        return faces_of_kind(kinds[both], surface.mask[both], kind, begin)

    every = [(rows, kind) for kind in range(KINDS) for rows in bands]
    return MeshRows(
        surface.unit,
        int(per_row.sum()),
        count,
        normals is not None,
        colours is not None,
        (_vertices(surface, rows, normals, colours) for rows in bands),
        (faces(rows, kind, int(first[rows.start])) for rows, kind in every),
        (_points(surface, rows)[faces(rows, kind, 0)] for rows, kind in every),
    )


def _both(surface: HeightMap, rows: slice) -> slice:
    """Return rows and the next one."""
    return slice(rows.start, min(rows.stop + 1, len(surface.mask)))


def _points(surface: HeightMap, rows: slice) -> Float32:
    """Return the points of rows and of the next one."""
    both = _both(surface, rows)
    return surface.points(both)[surface.mask[both]]


def _vertices(
    surface: HeightMap, rows: slice, normals: NormalRows | None, colours: MapRows | None
) -> Vertices:
    inside = surface.mask[rows]
    painted = None if colours is None else colours[rows][inside]
    if painted is not None and painted.ndim == 1:
        painted = painted[:, None]
    facing = None if normals is None else normals.normals[rows][inside]
    return surface.points(rows)[inside], facing, painted


def _kinds(surface: HeightMap, bands: list[slice]) -> UInt8:
    """Return the kinds of the triangles of each square, a byte for each pixel."""
    kinds, jumps = np.zeros(surface.mask.shape, np.uint8), surface.jumps
    for rows in bands:
        both = _both(surface, rows)
        parts = np.ascontiguousarray(surface.maps["parts"][both])
        cuts = () if jumps is None else (jumps.right[both], jumps.down[both])
        kinds[both] = kinds_of_triangles(parts, _points(surface, rows), *cuts)
    return kinds
