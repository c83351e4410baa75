"""The complete mesh of a surface, row by row: as a whole it takes much memory."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from acquisition import MapRows
from acquisition.files import rows_in_bands
from processing.meshes.face_kernels import KINDS, faces_of_kind, kinds_of_triangles
from processing.meshes.mesh import no_triangle
from processing.meshes.mesh_pieces import Piece, PlyForm, stl_facets, stl_header
from processing.stages.stage import NormalRows
from processing.surface.height_map import HeightMap
from rig.arrays import Float32, UInt8

# Bytes of a pixel with its points and triangles, and of a band.
_PIXEL, _BAND = 150, 1 << 26


def complete_mesh(
    surface: HeightMap, suffix: str, normals: NormalRows | None, colours: MapRows | None
) -> Iterator[Piece]:
    """Yield the complete mesh of a surface of which rows are read, as a .ply or .stl file.

    A file has a section for each kind of triangle. The kinds of each square of four pixels are kept
    in memory, one byte per pixel. The parameters are those of `write_mesh`.

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
    if suffix == ".ply":
        return _ply(surface, bands, kinds, count, normals, colours)
    return _stl(surface, bands, kinds, count)


def _both(surface: HeightMap, rows: slice) -> slice:
    """Return rows and the next one."""
    return slice(rows.start, min(rows.stop + 1, len(surface.mask)))


def _points(surface: HeightMap, rows: slice) -> Float32:
    """Return the points of rows and of the next one."""
    both = _both(surface, rows)
    return surface.points(both)[surface.mask[both]]


def _kinds(surface: HeightMap, bands: list[slice]) -> UInt8:
    """Return the kinds of the triangles of each square, a byte for each pixel."""
    kinds, jumps = np.zeros(surface.mask.shape, np.uint8), surface.jumps
    for rows in bands:
        both = _both(surface, rows)
        parts = np.ascontiguousarray(surface.maps["parts"][both])
        cuts = () if jumps is None else (jumps.right[both], jumps.down[both])
        kinds[both] = kinds_of_triangles(parts, _points(surface, rows), *cuts)
    return kinds


def _ply(
    surface: HeightMap,
    bands: list[slice],
    kinds: UInt8,
    count: int,
    normals: NormalRows | None,
    colours: MapRows | None,
) -> Iterator[Piece]:
    form = PlyForm(surface.unit, normals is not None, colours is not None)
    yield form.header(int(np.count_nonzero(surface.mask)), count)
    for rows in bands:
        inside = surface.mask[rows]
        painted = None if colours is None else colours[rows][inside]
        if painted is not None and painted.ndim == 1:
            painted = painted[:, None]
        yield form.vertices(
            surface.points(rows)[inside],
            None if normals is None else normals.normals[rows][inside],
            painted,
        )
    per_row = np.count_nonzero(surface.mask, axis=1)
    first = np.cumsum(per_row) - per_row
    for kind in range(KINDS):
        for rows in bands:
            both = _both(surface, rows)
            yield form.faces(
                faces_of_kind(kinds[both], surface.mask[both], kind, int(first[rows.start]))
            )


def _stl(surface: HeightMap, bands: list[slice], kinds: UInt8, count: int) -> Iterator[Piece]:
    yield stl_header(surface.unit, count)
    for kind in range(KINDS):
        for rows in bands:
            both = _both(surface, rows)
            faces = faces_of_kind(kinds[both], surface.mask[both], kind)
            yield stl_facets(_points(surface, rows)[faces])
