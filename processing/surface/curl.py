"""Curl of a normal map: where its normals are not those of one surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition import CameraModel, DataError, MapRows
from acquisition.files import MapToFill, rows_in_bands
from processing.maps.normal_map import check_normal_rows
from processing.stages.stage import NormalRows, size_of
from processing.surface.chord_rule import ChordRule
from rig import Notice, short_repr
from rig.arrays import Bool, Float32

# Rows at a time: the steps of all pixels would take much memory.
_BAND = 256

# Standard deviation of a normal distribution over its median absolute value.
_NORMAL = 1.4826
# The deviations do not explain the curl if it is larger by this factor, and larger than this angle.
# On simulated scenes it is up to 3.4 times larger, since the lens blurs fine relief.
_MOST_EXCESS = 5.0
_LEAST_DEG = 1.0


@dataclass(frozen=True, eq=False)
class NormalCurl:
    """By how much normals contradict the existence of a surface, at each pixel.

    Parameters
    ----------
    curl_deg
        ``(H, W)`` float32 curl in degrees, at the corner of a pixel and its neighbours to the right
        and below; NaN where one of the four has no normal or faces away. Independent errors of the
        normals of 1 degree give a curl with a standard deviation of 1 degree.
    spread_deg
        Standard deviation of the curl from its median absolute value, so that jumps in depth and
        outlines do not count; NaN without any curl.
    excess
        The same of the curl relative to the standard deviations of the normals: about 1 if they
        explain it. NaN if they are not known.
    """

    curl_deg: MapRows
    spread_deg: float
    excess: float

    __repr__ = short_repr


def normal_curl(
    normal_map: NormalRows,
    *,
    camera: CameraModel | None = None,
    sigma_deg: MapRows | None = None,
    into: MapToFill | None = None,
) -> NormalCurl:
    """Return the curl of the slopes that normals imply.

    The steps of the chord rule around four neighbouring pixels add up to 0 on every surface. Their
    sum in pixels is converted to the angle by which one of the normals has to turn to remove it.
    The sign is that of dq/dx - dp/dy of the slopes p = dz/dx and q = dz/dy.

    Parameters
    ----------
    normal_map
        The normals.
    camera
        A perspective camera of the same image size; without a camera the view is orthographic.
    sigma_deg
        ``(H, W)`` standard deviations of the normals in degrees, as for `integrate`.
    into
        ``(H, W)`` float32 map that is filled, perhaps in a file; default: a new array.

    Raises
    ------
    DataError
        If camera or deviations have another size.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, normal_curl
    >>> noise = np.radians(1) / np.sqrt(2) * np.random.default_rng(1).normal(size=(60, 80, 3))
    >>> found = normal_curl(NormalMap.from_vectors(noise + [0.3, 0.2, 0.9]))
    >>> f"{found.spread_deg:.1f}"
    '1.0'
    """
    check_normal_rows("normal_map", normal_map)
    normals, mask = normal_map.normals, normal_map.mask
    rows, columns = shape = size_of(normal_map)
    if camera is not None and camera.size != shape:
        raise DataError(f"a camera of {camera.size} does not fit normals of {shape}")
    if sigma_deg is not None and sigma_deg.shape != shape:
        raise DataError(f"deviations of {sigma_deg.shape} do not fit normals of {shape}")
    curl_deg = np.full(shape, np.nan, np.float32) if into is None else into
    # Medians of all pixels: 4 bytes for each.
    sizes, ratios = np.zeros((2, rows * columns), np.float32)
    count = known = 0
    for band in rows_in_bands(rows, 1, _BAND):
        # The curl of a row needs the next one.
        both = slice(band.start, min(band.stop + 1, rows))
        curl = np.full((band.stop - band.start, columns), np.nan, np.float32)
        found = _curl_between(normals[both], mask[both], both, camera)
        curl[: len(found), :-1] = found
        curl_deg[band] = curl
        inside = np.isfinite(found)
        size = np.abs(found[inside])
        sizes[count : count + len(size)] = size
        count += len(size)
        if sigma_deg is not None:
            expected = np.sqrt(_mean_of_four(np.square(sigma_deg[both])))[inside]
            ratio = size[expected > 0] / expected[expected > 0]
            ratios[known : known + len(ratio)] = ratio
            known += len(ratio)
    spread, excess = (
        _NORMAL * float(np.median(values[:number], overwrite_input=True)) if number else np.nan
        for values, number in ((sizes, count), (ratios, known))
    )
    return NormalCurl(curl_deg, spread, excess)


def _curl_between(normals: Float32, mask: Bool, rows: slice, camera: CameraModel | None) -> Float32:
    """Return the ``(h-1, W-1)`` curl between the pixels of rows, NaN without one."""
    chords = ChordRule((rows, slice(0, mask.shape[1])), camera)
    right, down, step_right, step_down = chords.edges(normals, mask)
    here, after, below = np.s_[1:-2, 1:-2], np.s_[1:-2, 2:-1], np.s_[2:-1, 1:-2]
    inside = (right[here] > 0) & (right[below] > 0) & (down[here] > 0) & (down[after] > 0)
    # A logarithm of depths falls where the height rises.
    scale = chords.step_px if camera is None else -chords.step_px
    closure = scale * (step_right[below] + step_down[here] - step_right[here] - step_down[after])
    del right, down, step_right, step_down
    facing = chords.facing(normals, mask)[1:-1, 1:-1]
    square = np.square(_mean_of_four(facing))
    # Of errors of one variance s^2 in each tangent direction, the variance of the sum is
    # s^2 (1 + c^2) / c^4 with the cosine c.
    angle = np.degrees(closure * square * np.sqrt(2 / (1 + square)))
    found: Float32 = np.where(inside, angle, np.nan).astype(np.float32)
    return found


def _mean_of_four(values: Float32) -> Float32:
    mean: Float32 = values[:-1, :-1] + values[:-1, 1:] + values[1:, :-1] + values[1:, 1:]
    return mean * np.float32(0.25)


def curl_notices(curl: NormalCurl) -> list[Notice]:
    """Return a notice if the normals contradict each other more than their deviations explain.

    Parameters
    ----------
    curl
        The curl of the normals.

    Returns
    -------
    list of Notice
        ``curl-not-explained`` if the curl exceeds the standard deviations of the normals nearly
        everywhere: the normals have other errors.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, normal_curl
    >>> from processing.surface import curl_notices
    >>> slope = NormalMap.from_vectors(np.full((30, 30, 3), [-1.0, 0.0, 1.0]))
    >>> curl_notices(normal_curl(slope))
    []
    """
    if not (curl.excess > _MOST_EXCESS and curl.spread_deg > _LEAST_DEG):
        return []
    text = (
        f"the curl of the normals ({curl.spread_deg:.1f} degrees) is {curl.excess:.1f} times "
        "as large as their standard deviations explain: the normals have other errors than "
        "noise, so those of the heights are larger than predicted"
    )
    return [Notice("curl-not-explained", text)]
