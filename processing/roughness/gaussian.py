"""Gaussian filters of areas and profiles (ISO 16610-21, -61), and robust ones (-31, -71)."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.optimize import brentq
from scipy.signal import oaconvolve

from processing.maps.local_planes import fit_planes
from rig.arrays import Bool, Float64, Floating

# The filter transmits half of a wave as long as its nesting index (ISO 16610-21, equation 4).
_ALPHA: Final = math.sqrt(math.log(2) / math.pi)
DEVIATION: Final = _ALPHA / math.sqrt(2 * math.pi)
# Deviations beyond this many medians have no weight (ISO 16610-31, -71).
_TUKEY = 4.4478
_ROUNDS = 12
# Change of the weights, on average, at which they count as found.
_SETTLED = 1e-3
_REACH = 5.5
# Variance of a blur, in square pixels, that changes nothing that pixels show.
_LEAST_VARIANCE = 1e-4
_OFFSETS: Final = np.arange(-8, 9)


def mean_surface(
    heights: Floating, nesting_px: float, *, robust: bool = False, removed_px: float = 0.0
) -> Floating:
    """Return the waves of an area that are longer than the nesting index.

    A plane is fitted around each pixel, so the filter has no end effects on slopes: masks, holes
    and borders need no values beyond them (regression filter of order 1, ISO/TS 16610-28).

    Parameters
    ----------
    heights
        ``(H, W)``, NaN where they are not known.
    nesting_px
        Nesting index in pixels.
    robust
        Give pixels far from the mean surface little weight.
    removed_px
        Standard deviation of a Gaussian blur that the heights already have.

    Returns
    -------
    ``(H, W)``, NaN where the heights are NaN, or too few around a pixel determine a plane.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.roughness import mean_surface
    >>> wave = np.cos(2 * np.pi * np.arange(-60, 61) / 20) * np.ones((121, 1))
    >>> round(float(mean_surface(wave, 20)[60, 60]), 3)
    0.5
    """
    scale = _missing(nesting_px, removed_px)
    known = np.isfinite(heights)
    if scale == 0:
        return heights
    weights: Floating | Bool = known
    for _ in range(_ROUNDS):
        planes = fit_planes(heights, weights, scale, slopes=False)
        found = planes.value
        found[~planes.known] = np.nan
        if not robust:
            break
        new = _tukey(heights - found)
        settled = np.abs(new - weights)[known].mean() < _SETTLED
        # A weight of exactly 0 would leave the pixel itself without a mean surface.
        weights = np.maximum(new, 1e-6 * known).astype(heights.dtype)
        if settled:
            break
    return found


def mean_line(
    heights: Float64, nesting_px: float, *, robust: bool = False, removed_px: float = 0.0
) -> Float64:
    """Return the waves of a profile ``(N,)`` that are longer than the nesting index.

    As `mean_surface`, with a straight line around each point.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.roughness import mean_line
    >>> wave = np.cos(2 * np.pi * np.arange(-60, 61) / 20)
    >>> round(float(mean_line(wave, 20)[60]), 3)
    0.5
    """
    scale = _missing(nesting_px, removed_px)
    if scale == 0:
        return heights
    reach = max(1, math.ceil(_REACH * scale))
    offset = np.arange(-reach, reach + 1, dtype=np.float64)
    window = np.exp(-0.5 * (offset / scale) ** 2)
    window /= window.sum()
    # A convolution turns the window round.
    first, second = -window * offset, window * offset**2
    known = np.isfinite(heights)
    weights = known.astype(np.float64)
    for _ in range(_ROUNDS):
        values = np.where(known, heights, 0.0) * weights
        total, at, square, mean, slope = (
            oaconvolve(image, kernel, mode="full")[reach:-reach]
            for image, kernel in (
                (weights, window),
                (weights, first),
                (weights, second),
                (values, window),
                (values, first),
            )
        )
        determinant = total * square - at * at
        usable = known & (determinant > 1e-6 * scale**2 * total**2)
        found = np.full(len(heights), np.nan)
        np.divide(square * mean - at * slope, determinant, out=found, where=usable)
        if not robust:
            break
        new = _tukey(heights - found)
        settled = np.abs(new - weights)[known].mean() < _SETTLED
        weights = np.maximum(new, 1e-6 * known)
        if settled:
            break
    return found


def _missing(nesting_px: float, removed_px: float) -> float:
    """Return the scale of weights that remove what a filter still removes after a blur, in pixels.

    The weights are samples of a Gaussian. Those of a narrow one have a smaller variance than the
    Gaussian; the scale is that of samples with the variance that is needed.
    """
    variance = (DEVIATION * nesting_px) ** 2 - removed_px**2
    if variance <= _LEAST_VARIANCE:
        return 0.0
    if variance > 1:
        return math.sqrt(variance)

    def of_samples(scale: float) -> float:
        weights = np.exp(-0.5 * (_OFFSETS / scale) ** 2)
        return float((weights * _OFFSETS**2).sum() / weights.sum())

    return float(brentq(lambda scale: of_samples(scale) - variance, 0.1, 1.1))


def _tukey(left: Floating) -> Floating:
    """Return the weights of Tukey's biweight, 0 where a deviation is not known."""
    size = np.abs(left)
    limit = _TUKEY * float(np.nanmedian(size))
    if limit == 0:
        return np.isfinite(left).astype(left.dtype)
    inside = size < limit
    return np.where(inside, (1 - (left / limit) ** 2) ** 2, 0).astype(left.dtype)
