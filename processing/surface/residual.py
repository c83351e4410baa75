"""Angles between the normals of an integrated surface and those that it was computed from."""

from __future__ import annotations

import numpy as np

from acquisition import DataError, MapRows
from acquisition.files import MapToFill, rows_in_bands
from processing.maps.normal_map import check_normal_rows
from processing.stages.stage import NormalRows
from processing.surface.height_map import HeightMap
from rig import check_type
from rig.arrays import Bool, Float32, Float64

# Bytes of a pixel with its points and tangents, and of a band.
_PIXEL, _BAND = 400, 1 << 25


def normal_residual(
    height_map: HeightMap, normal_map: NormalRows, into: MapToFill | None = None
) -> MapRows:
    """Return by how much the normals of a surface differ from those that it was computed from.

    The normal of a pixel of the surface is at right angles to the mean chords to its neighbours in
    its row and in its column. Chords across jumps or between parts do not count. Where the angles
    are large, no surface has the given normals, or the integration smoothed a step.

    Parameters
    ----------
    height_map
        The surface.
    normal_map
        The normals that it was integrated from.
    into
        ``(H, W)`` float32 map that is filled, perhaps in a file; default: a new array.

    Returns
    -------
    MapRows
        ``(H, W)`` float32 angles in degrees, 0 to 180; NaN outside the surface, and at pixels
        without a neighbour in their row or in their column.

    Raises
    ------
    DataError
        If the maps have different sizes.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, integrate, normal_residual
    >>> slope = NormalMap.from_vectors(np.full((4, 6, 3), [-1.0, 0.0, 1.0]))
    >>> bool(normal_residual(integrate(slope), slope).max() < 0.1)
    True
    """
    check_type("height_map", height_map, HeightMap, "integrate(normal_map) returns one")
    check_normal_rows("normal_map", normal_map)
    rows, columns = height_map.mask.shape
    if normal_map.mask.shape != (rows, columns):
        raise DataError(
            f"a surface of {columns} x {rows} pixels does not fit a normal map of "
            f"{normal_map.mask.shape[1]} x {normal_map.mask.shape[0]}: give the map it was "
            "integrated from"
        )
    angles = np.full((rows, columns), np.nan, np.float32) if into is None else into
    for band in rows_in_bands(rows, _PIXEL * columns, _BAND):
        angles[band] = _of_rows(height_map, normal_map.normals, band)
    return angles


def _of_rows(surface: HeightMap, normals: MapRows, rows: slice) -> Float32:
    first, last = max(rows.start - 1, 0), min(rows.stop + 1, len(surface.mask))
    window = slice(first, last)
    points = surface.points(window).astype(np.float64)
    cut_right, cut_down = _cuts(surface, window)
    across = _tangents(points, cut_right)
    along = _tangents(points.swapaxes(0, 1), cut_down.T).swapaxes(0, 1)
    facing = np.cross(along, across)  # rows run down, Y up: toward the camera
    given = normals[window].astype(np.float64)
    sine = np.linalg.norm(np.cross(facing, given), axis=2)
    cosine = np.einsum("rck,rck->rc", facing, given)
    both = np.degrees(np.arctan2(sine, cosine))
    found: Float32 = both[rows.start - first : rows.stop - first].astype(np.float32)
    return found


def _cuts(surface: HeightMap, rows: slice) -> tuple[Bool, Bool]:
    """Return where a pixel and its right (lower) neighbour have no chord."""
    parts, jumps = surface.maps["parts"][rows], surface.jumps
    right, down = np.zeros((2, *parts.shape), bool)
    right[:, :-1] = parts[:, 1:] != parts[:, :-1]
    down[:-1] = parts[1:] != parts[:-1]
    if jumps is not None:
        right |= jumps.right[rows]
        down |= jumps.down[rows]
    return right, down


def _tangents(points: Float64, cut: Bool) -> Float64:
    """Return the mean chord of each point along its row; NaN without any."""
    chords = np.diff(points, axis=1)
    known = np.isfinite(chords[..., :1]) & ~cut[:, :-1, None]
    chords = np.where(known, chords, 0)
    sums, counts = np.zeros_like(points), np.zeros((*points.shape[:2], 1))
    for side in (np.s_[:, :-1], np.s_[:, 1:]):
        sums[side] += chords
        counts[side] += known
    return np.divide(sums, counts, out=np.full_like(sums, np.nan), where=counts > 0)
