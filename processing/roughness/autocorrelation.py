"""Spatial parameters: autocorrelation length, aspect ratio and direction of a texture."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import map_coordinates

from rig.arrays import Float32, Floating

# The autocorrelation decays to this (ISO 25178-2).
_DECAY = 0.2
# Largest shift in pixels.
_MOST_PX = 512
_DIRECTIONS = 360
# Fewest pairs of pixels of a shift, relative to all pixels.
_FEWEST = 0.1


class Texture(NamedTuple):
    """Directions and lengths of a texture; NaN where they are not defined.

    Parameters
    ----------
    shortest_px
        Shortest shift at which the autocorrelation decays to 0.2.
    aspect
        The shortest such shift divided by the longest: 1 for a texture without a direction. NaN if
        it does not decay in some direction within the area.
    direction_deg
        Direction of the lay, counter-clockwise from X, -90 to 90.
    """

    shortest_px: float
    aspect: float
    direction_deg: float


def texture(heights: Floating) -> Texture:
    """Return lengths and direction of the texture of ``(H, W)`` heights, NaN outside the area."""
    rows, columns = (
        slice(int(at.min()), int(at.max()) + 1) for at in np.nonzero(~np.isnan(heights))
    )
    part = heights[rows, columns]
    part = np.asarray(part - np.nanmean(part), np.float32)
    correlation, reach = autocorrelation(part)
    angles = np.arange(_DIRECTIONS) * math.pi / _DIRECTIONS
    lengths = np.arange(0, reach + 0.25, 0.25)
    x = reach + np.cos(angles)[:, None] * lengths
    y = reach - np.sin(angles)[:, None] * lengths
    # Where a correlation is not known, it does not decay.
    known = np.isfinite(correlation)
    along = map_coordinates(np.where(known, correlation, 1), [y, x], order=3, mode="nearest")
    low = along <= _DECAY
    first = np.argmax(low, axis=1)
    found = low.any(axis=1)
    every = np.arange(_DIRECTIONS)
    before, after = along[every, np.maximum(first - 1, 0)], along[every, first]
    share = (before - _DECAY) / np.where(found, before - after, 1)
    radius = np.where(found, 0.25 * (first - 1 + share), np.nan)
    # Where it does not decay, its end is not known.
    if not np.isfinite(radius).any():
        return Texture(math.nan, math.nan, _direction(part))
    shortest = float(np.nanmin(radius))
    longest = float(np.nanmax(radius)) if np.isfinite(radius).all() else math.nan
    return Texture(shortest, shortest / longest, _direction(part))


def autocorrelation(heights: Float32) -> tuple[Float32, int]:
    """Return the autocorrelation of heights for shifts up to a reach in pixels.

    Each shift counts the pairs of pixels that are both known, so a border or a hole does not make
    it smaller.

    Returns
    -------
    correlation
        ``(2 R + 1, 2 R + 1)`` float32, 1 in the middle; NaN where few pairs are known.
    reach
        R, half of the shorter side at most.
    """
    known = np.isfinite(heights)
    reach = max(1, min(min(heights.shape) // 2, _MOST_PX))
    size = tuple(next_fast_len(side + reach, real=True) for side in heights.shape)
    sums = _shifted_sums(np.where(known, heights, 0), size, reach)
    pairs = _shifted_sums(known.astype(np.float32), size, reach)
    enough = pairs > _FEWEST * np.count_nonzero(known)
    covariance = np.where(enough, sums / np.maximum(pairs, 1), np.nan)
    return np.asarray(covariance / covariance[reach, reach], np.float32), reach


def _shifted_sums(image: Floating, size: tuple[int, ...], reach: int) -> Float32:
    spectrum = rfft2(np.asarray(image, np.float32), size)
    power = np.square(spectrum.real) + np.square(spectrum.imag)
    del spectrum
    whole = irfft2(power, size)
    shift = np.arange(-reach, reach + 1)
    return np.asarray(whole[np.ix_(shift, shift)], np.float32)


def _direction(heights: Float32) -> float:
    """Return the direction of the lay: at right angles to that of the strongest waves.

    The angular spectrum is the sum of the power along each direction (ISO 25178-2, Std).
    """
    known = np.isfinite(heights)
    height, width = heights.shape
    window = np.outer(np.hanning(height + 2)[1:-1], np.hanning(width + 2)[1:-1])
    tapered = np.where(known, heights, 0) * window.astype(np.float32)
    side = next_fast_len(max(height, width), real=True)
    spectrum = rfft2(tapered, (side, side))
    power = np.square(np.abs(spectrum))
    down = np.fft.fftfreq(side)[:, None]
    right = np.fft.rfftfreq(side)[None]
    # Y is up; waves at an angle have crests at right angles to it.
    angle = np.degrees(np.arctan2(-down, right))
    length = np.hypot(down, right)
    inside = (length > 0) & (length < 0.5)
    total = np.bincount(
        (np.round(angle[inside]).astype(int) + 90) % 180, power[inside], minlength=180
    )
    # A few degrees are averaged: spectra of rough surfaces scatter.
    around = np.convolve(np.tile(total, 3), np.hanning(9)[1:-1], mode="same")[180:360]
    best = int(np.argmax(around))
    before, top, after = around[best - 1], around[best], around[(best + 1) % 180]
    curvature = before - 2 * top + after
    offset = 0.5 * (before - after) / curvature if curvature < 0 else 0.0
    # Waves at -90 degrees, the first one, have crests at 0.
    return float((best + offset + 90) % 180 - 90)
