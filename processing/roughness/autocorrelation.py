"""Spatial parameters: autocorrelation length, aspect ratio and direction of a texture."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import map_coordinates

from processing.maps.mask import bounding_box
from rig.arrays import Float32, Float64, Floating, Intp

# The autocorrelation decays to this (ISO 25178-2).
_DECAY = 0.2
# Largest shift in pixels.
_MOST_PX = 512
_DIRECTIONS = 360
# Fewest pairs of pixels of a shift, relative to all pixels.
_FEWEST = 0.1
# Larger areas are divided into tiles of this side, up to twice as large.
_TILE_PX = 2048


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
    known = np.isfinite(heights)
    within = bounding_box(known)
    mean = np.mean(heights, dtype=np.float64, where=known)
    part = np.asarray(heights[within] - heights.dtype.type(mean), np.float32)
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
    reach = max(1, min(min(heights.shape) // 2, _MOST_PX))
    sums, pairs = np.zeros((2, 2 * reach + 1, 2 * reach + 1))
    for rows, columns in _tiles(heights.shape, _TILE_PX):
        first = heights[rows, columns]
        second = heights[max(rows.start - reach, 0) : rows.stop + reach]
        second = second[:, max(columns.start - reach, 0) : columns.stop + reach]
        before = min(rows.start, reach), min(columns.start, reach)
        sums += _products(np.nan_to_num(first), np.nan_to_num(second), before, reach)
        first, second = (np.isfinite(part).astype(np.float32) for part in (first, second))
        pairs += _products(first, second, before, reach)
    enough = pairs > _FEWEST * pairs[reach, reach]
    covariance = np.where(enough, sums / np.maximum(pairs, 1), np.nan)
    return np.asarray(covariance / covariance[reach, reach], np.float32), reach


def _tiles(shape: tuple[int, ...], side: int) -> Iterator[tuple[slice, slice]]:
    """Yield tiles of equal size, of at most twice a side."""
    counts = [max(1, size // side) for size in shape]
    edges = [
        np.linspace(0, size, count + 1).astype(int)
        for size, count in zip(shape, counts, strict=True)
    ]
    for rows, columns in product(*map(pairwise, edges)):
        yield slice(*map(int, rows)), slice(*map(int, columns))


def _products(first: Float32, second: Float32, before: tuple[int, int], reach: int) -> Float64:
    """Return the sums of ``first[p] second[p + s]`` over p, for shifts s up to the reach.

    ``second`` begins ``before`` the first row and column of ``first``.
    """
    size = [
        next_fast_len(max(a + lead + reach, b), real=True)
        for a, b, lead in zip(first.shape, second.shape, before, strict=True)
    ]
    spectrum = rfft2(second, size)
    other = spectrum if first.shape == second.shape else rfft2(first, size)
    whole = irfft2(spectrum * np.conj(other), size)
    down, right = (lead + np.arange(-reach, reach + 1) for lead in before)
    return np.asarray(whole[np.ix_(down, right)], np.float64)


def _direction(heights: Float32) -> float:
    """Return the direction of the lay: at right angles to that of the strongest waves.

    The angular spectrum is the sum of the power along each direction (ISO 25178-2, Std).
    """
    total = np.zeros(180)
    side = 0
    for rows, columns in _tiles(heights.shape, _TILE_PX):
        part = np.nan_to_num(heights[rows, columns])
        if max(part.shape) > side:
            side = next_fast_len(max(part.shape), real=True)
            angle = _angles(side)
        taper = np.outer(*(np.hanning(size + 2)[1:-1] for size in part.shape))
        spectrum = rfft2(part * taper.astype(np.float32), (side, side))
        power = np.square(spectrum.real) + np.square(spectrum.imag)
        total += np.bincount(angle.ravel(), power.ravel(), minlength=181)[:180]
    # A few degrees are averaged: spectra of rough surfaces scatter.
    around = np.convolve(np.tile(total, 3), np.hanning(9)[1:-1], mode="same")[180:360]
    best = int(np.argmax(around))
    before, top, after = around[best - 1], around[best], around[(best + 1) % 180]
    curvature = before - 2 * top + after
    offset = 0.5 * (before - after) / curvature if curvature < 0 else 0.0
    # Waves at -90 degrees, the first one, have crests at 0.
    return float((best + offset + 90) % 180 - 90)


def _angles(side: int) -> Intp:
    """Return the directions of the waves of a spectrum in degrees, 0..179 from -90; else 180."""
    down = np.fft.fftfreq(side)[:, None]
    right = np.fft.rfftfreq(side)[None]
    # Y is up; waves at an angle have crests at right angles to it.
    angle = np.degrees(np.arctan2(-down, right))
    length = np.hypot(down, right)
    inside = (length > 0) & (length < 0.5)
    return np.where(inside, (np.round(angle).astype(int) + 90) % 180, 180)
