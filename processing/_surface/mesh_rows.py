"""Meshes of surfaces that are larger than memory."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from acquisition import DataError, MapRows, rows_in_bands, write_pieces
from processing._surface.face_kernels import KINDS, faces_of_kind, kinds_of_triangles
from processing._surface.height_map import HeightRows, points_of_rows
from processing._surface.mesh_pieces import Piece, PlyForm, stl_facets, stl_header

Float = npt.NDArray[np.float32]
Kinds = npt.NDArray[np.uint8]

# Bytes of a pixel with its points and triangles, and of a band.
_PIXEL, _BAND = 150, 1 << 26


def write_mesh_rows(
    path: str | os.PathLike[str],
    surface: HeightRows,
    *,
    normals: MapRows | None = None,
    colours: MapRows | None = None,
) -> None:
    """Write the complete mesh of a surface of which rows are read, with the bytes of `write_mesh`.

    A file has a section for each kind of triangle. The kinds of each square of four pixels are kept
    in memory, one byte per pixel.

    Parameters
    ----------
    path
        ``.ply`` or ``.stl``. An existing file is replaced.
    surface
        The surface, in memory or in files.
    normals
        ``(H, W, 3)`` float32 normals of the vertices.
    colours
        ``(H, W)`` or ``(H, W, 3)`` uint8 sRGB colours of the vertices.

    Raises
    ------
    DataError
        If the suffix is another one, or the surface contains no triangle.
    StorageError
        If the file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from processing import NormalMap, integrate, write_mesh_rows
    >>> slope = NormalMap.from_vectors(np.full((4, 6, 3), [-1.0, 0.0, 1.0]))
    >>> write_mesh_rows("slope.stl", integrate(slope))
    >>> Path("slope.stl").stat().st_size == 84 + 50 * 30
    True
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (".ply", ".stl"):
        raise DataError(f"{path}: a mesh of a surface in files is a .ply or .stl file")
    height, width = surface.mask.shape
    bands = rows_in_bands(height, _PIXEL * width, _BAND, least=2)
    kinds = _kinds(surface, bands)
    count = sum(int(np.count_nonzero(kinds & (1 << kind))) for kind in range(KINDS))
    if not count:
        raise DataError(
            "the surface contains no triangle: it is nowhere two pixels wide; check the mask"
        )
    if suffix == ".ply":
        write_pieces(path, _ply(surface, bands, kinds, count, normals, colours))
    else:
        write_pieces(path, _stl(surface, bands, kinds, count))


def _both(surface: HeightRows, rows: slice) -> slice:
    """Return rows and the next one."""
    return slice(rows.start, min(rows.stop + 1, len(surface.mask)))


def _points(surface: HeightRows, rows: slice) -> Float:
    """Return the points of rows and of the next one."""
    both = _both(surface, rows)
    return points_of_rows(surface, both)[surface.mask[both]]


def _kinds(surface: HeightRows, bands: list[slice]) -> Kinds:
    """Return the kinds of the triangles of each square, a byte for each pixel."""
    kinds = np.zeros(surface.mask.shape, np.uint8)
    for rows in bands:
        both = _both(surface, rows)
        parts = np.ascontiguousarray(surface.parts[both])
        kinds[both] = kinds_of_triangles(parts, _points(surface, rows))
    return kinds


def _ply(
    surface: HeightRows,
    bands: list[slice],
    kinds: Kinds,
    count: int,
    normals: MapRows | None,
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
            points_of_rows(surface, rows)[inside],
            None if normals is None else normals[rows][inside],
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


def _stl(surface: HeightRows, bands: list[slice], kinds: Kinds, count: int) -> Iterator[Piece]:
    yield stl_header(surface.unit, count)
    for kind in range(KINDS):
        for rows in bands:
            both = _both(surface, rows)
            faces = faces_of_kind(kinds[both], surface.mask[both], kind)
            yield stl_facets(_points(surface, rows)[faces])
