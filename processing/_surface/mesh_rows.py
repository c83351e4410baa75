"""Meshes of surfaces that are larger than memory."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from acquisition import DataError, MapRows, rows_in_bands, write_pieces
from processing._surface.face_kernels import faces_by_kind
from processing._surface.height_map import HeightRows, points_of_rows
from processing._surface.mesh_pieces import Piece, PlyForm, stl_facets, stl_header

Float = npt.NDArray[np.float32]

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

    The triangles are computed once for each kind of which the file has a section, so that they need
    not be kept.

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
    count = sum(int(_band(surface, rows).counts.sum()) for rows in bands)
    if not count:
        raise DataError(
            "the surface contains no triangle: it is nowhere two pixels wide; check the mask"
        )
    if suffix == ".ply":
        write_pieces(path, _ply(surface, bands, count, normals, colours))
    else:
        write_pieces(path, _stl(surface, bands, count))


class _Band(NamedTuple):
    """Points and triangles of rows and of the next one.

    Parameters
    ----------
    points
        ``(N, 3)`` float32.
    faces
        ``(F, 3)`` numbers of points, in sections of one kind each.
    counts
        ``(4,)`` triangles of each section.
    """

    points: Float
    faces: npt.NDArray[np.int32]
    counts: npt.NDArray[np.int64]

    def section(self, kind: int) -> npt.NDArray[np.int32]:
        end = int(self.counts[: kind + 1].sum())
        return self.faces[end - int(self.counts[kind]) : end]


def _band(surface: HeightRows, rows: slice) -> _Band:
    both = slice(rows.start, min(rows.stop + 1, len(surface.mask)))
    points = points_of_rows(surface, both)[surface.mask[both]]
    return _Band(points, *faces_by_kind(np.ascontiguousarray(surface.parts[both]), points))


def _sections(surface: HeightRows, bands: list[slice]) -> Iterator[tuple[int, _Band, int]]:
    """Yield the number of the first point of each band, the band and the kind of triangles."""
    before = np.concatenate([[0], np.cumsum(np.count_nonzero(surface.mask, axis=1))])
    for kind in range(4):
        for rows in bands:
            yield int(before[rows.start]), _band(surface, rows), kind


def _ply(
    surface: HeightRows,
    bands: list[slice],
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
    for first, band, kind in _sections(surface, bands):
        yield form.faces(band.section(kind).astype(np.int64) + first)


def _stl(surface: HeightRows, bands: list[slice], count: int) -> Iterator[Piece]:
    yield stl_header(surface.unit, count)
    for _, band, kind in _sections(surface, bands):
        yield stl_facets(band.points[band.section(kind)])
