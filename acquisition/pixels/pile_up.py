"""Samples that pile up at one value, because they were clipped there.

A value is a pile-up if many samples of a recording are equal to it, far more than to any value just
below, and hardly any is brighter. An even area that is the brightest of the scene looks the same
without noise, so other images decide: samples that are equal because they were clipped differ under
other lights.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Final, NamedTuple

import cv2
import numpy as np

from acquisition.pixels.images import Image
from rig.arrays import AnyArray, Int64

Reader = Callable[[], Image | None]

# The values just below are those within a 64th, at least four. The most frequent one counts: the
# largest value of a smooth surface without noise occurs 2.4 times as often as the next, at most.
_NEAR: Final = 64
_LEAST_NEAR: Final = 4
_PILE: Final = 4
_LEAST_PILE: Final = 16
# Brighter samples are hot pixels, or an interpolation of colours that overshoots.
_BRIGHTER: Final = 20
# By so many of 255 values JPEG spreads samples at quality 75.
_SPREAD: Final = 16
_BRIGHTEST_FLOATS: Final = 1024
# Largest values of converters; there no other image has to decide.
_CONVERTER_ENDS: Final = (2**10 - 1, 2**12 - 1, 2**14 - 1)
# Samples of a pile-up say nothing in another image where they are in shadow, below a 64th.
# An even area has one value there; half of the samples allow for few grey values.
_DARK: Final = 64
_SAME: Final = 0.5
# A matte area is not so much darker under most other lights; a highlight is.
_GLOSS: Final = 8
_WITNESSES: Final = 8
# Images in memory at a time; and samples that are counted at a time, exactly with float32.
_THREADS: Final = 2
_PART: Final = 1 << 22


class PileUp(NamedTuple):
    """Values at which samples were clipped.

    Parameters
    ----------
    levels
        The value by plane (see `planes_of`), NaN where nothing is clipped.
    samples
        Number of clipped samples.
    brightest
        The largest value of the planes in which nothing is clipped, 0 without such a plane.
    """

    levels: tuple[float, ...]
    samples: int
    brightest: float


def planes_of(pixels: AnyArray, side: int) -> list[AnyArray]:
    """Return views of the samples of each colour, or of each position of a filter's block."""
    if pixels.ndim == 3:
        return [pixels[..., colour] for colour in range(pixels.shape[2])]
    return [pixels[y::side, x::side] for y in range(side) for x in range(side)]


def find_pile_up(images: Sequence[Reader], side: int, white: float) -> PileUp | None:
    """Return where samples of a recording were clipped below its white level; None if nowhere.

    Parameters
    ----------
    images
        Readers of its images, which return None for one that cannot be read.
    side
        Side of the block of the colour filter; 1 without a filter.
    white
        The white level that is assumed so far. It is infinite for floats.
    """
    planes: list[_Histogram] = []
    with ThreadPoolExecutor(_THREADS) as pool:
        # In groups, because the pool would read further images before the results are used.
        for first in range(0, len(images), _THREADS):
            numbers = range(first, min(first + _THREADS, len(images)))
            for found in pool.map(partial(_histograms, images, side), numbers):
                joined = [one.joined(two) for one, two in zip(planes, found, strict=False)]
                planes = joined or planes or found
    levels, samples = [], 0
    for index, histogram in enumerate(planes):
        level, count = histogram.pile(white)
        if count and level not in _CONVERTER_ENDS:
            count *= _varies(images, side, index, level, histogram)
        levels.append(histogram.lowest(level) if count else np.nan)
        samples += int(histogram.counts[histogram.values >= levels[-1]].sum())
    if not samples:
        return None
    tops = [histogram.values.max(initial=0) for histogram in planes]
    unclipped = [float(top) for top, level in zip(tops, levels, strict=True) if np.isnan(level)]
    return PileUp(tuple(levels), samples, max(unclipped, default=0.0))


@dataclass(frozen=True)
class _Histogram:
    """How often the values of a plane occur.

    Parameters
    ----------
    values, counts
        The values, increasing, and the number of samples of each.
    images
        By value, the image in which most samples pile up at it, and how many they are.
    """

    values: AnyArray
    counts: Int64
    images: dict[float, tuple[int, int]]

    def joined(self, other: _Histogram) -> _Histogram:
        values, place = np.unique(np.concatenate([self.values, other.values]), return_inverse=True)
        counts = np.zeros(len(values), np.int64)
        np.add.at(counts, place, np.concatenate([self.counts, other.counts]))
        images = dict(self.images)
        for value, most in other.images.items():
            images[value] = max(images.get(value, (0, 0)), most)
        return _Histogram(values, counts, images)

    @property
    def has_eight_bits(self) -> bool:
        return self.values.dtype.kind != "f" and self.values.max(initial=0) < 2**8

    def piles(self, white: float) -> list[tuple[float, int]]:
        """Return the values below white at which samples pile up, and their numbers."""
        brighter = np.cumsum(self.counts[::-1])[::-1] - self.counts
        if self.has_eight_bits:
            past = np.searchsorted(self.values, self.values + _SPREAD, "right")
            brighter = np.append(brighter + self.counts, 0)[past]
        often = (self.counts >= _LEAST_PILE) & (self.counts >= _BRIGHTER * brighter)
        found = []
        for at in np.flatnonzero(often & (self.values < white)):
            value, count = float(self.values[at]), int(self.counts[at])
            near = value / _NEAR
            if self.values.dtype.kind != "f":
                near = max(near, _LEAST_NEAR)
            below = self.counts[np.searchsorted(self.values, value - near) : at]
            above = self.counts[at + 1 : past[at]] if self.has_eight_bits else below[:0]
            if count < _PILE * above.max(initial=0):
                continue
            # A scene of which parts are clipped has values just below, too.
            if count >= _PILE * below.max(initial=0) and (len(below) or value in _CONVERTER_ENDS):
                found.append((value, count))
        return found

    def step_below(self, value: float) -> float:
        """Return the difference of a value that occurs to the next lower one."""
        at = int(np.searchsorted(self.values, value))
        return value - float(self.values[at - 1]) if at else value

    def lowest(self, value: float) -> float:
        """Return the lowest value whose samples rather belong to a pile, spread evenly by JPEG."""
        if not self.has_eight_bits:
            return value
        count = dict(zip(self.values.tolist(), self.counts.tolist(), strict=True))
        for step in range(1, _SPREAD + 1):
            above, below = (count.get(value + step, 0), count.get(value - step, 0))
            if not above or 2 * above < below:
                return value - step + 1
        return value - _SPREAD

    def pile(self, white: float) -> tuple[float, int]:
        """Return the value at which most samples pile up, and their number, which may be 0."""
        return max(self.piles(white), key=lambda pile: pile[1], default=(np.nan, 0))


def _histograms(images: Sequence[Reader], side: int, number: int) -> list[_Histogram]:
    pixels = images[number]()
    if pixels is None or not pixels.size:
        return []
    histograms = []
    for plane in planes_of(pixels, side):
        if plane.dtype.kind == "f":
            bright = plane[np.isfinite(plane)]
            if len(bright):
                # A pile-up is among the brightest; samples near it are less than a tenth below.
                bright = bright[bright >= 0.9 * np.quantile(bright, 1 - 1 / _BRIGHTER)]
            values, counts = np.unique(bright, return_counts=True)
            # Values that occur once are as many as samples; the largest of them are enough.
            kept = counts > 1
            kept[-_BRIGHTEST_FLOATS:] = True
            values, counts = values[kept], counts[kept]
        else:
            end = int(np.iinfo(plane.dtype).max) + 1
            counts = np.zeros(end, np.int64)
            rows = max(1, _PART // plane.shape[1])
            for top in range(0, len(plane), rows):
                part = np.ascontiguousarray(plane[top : top + rows])
                counts += cv2.calcHist([part], [0], None, [end], [0, end]).ravel().astype(np.int64)
            values = np.flatnonzero(counts)
            counts = counts[values]
        one = _Histogram(values, counts.astype(np.int64), {})
        most = {value: (count, number) for value, count in one.piles(np.inf)}
        histograms.append(_Histogram(one.values, one.counts, most))
    return histograms


def _varies(
    images: Sequence[Reader],
    side: int,
    index: int,
    level: float,
    histogram: _Histogram,
) -> bool:
    """Return whether samples that are equal in the pile-up of one image differ in others."""
    if level not in histogram.images:
        return False
    number = histogram.images[level][1]
    pixels = images[number]()
    if pixels is None:
        return False
    pile = planes_of(pixels, side)[index] == level
    shares: list[float] = []
    spreads: list[float] = []
    for other in (read for i, read in enumerate(images) if i != number):
        pixels = other()
        if pixels is None:
            continue
        values = planes_of(pixels, side)[index][pile]
        values = values[(values > level / _DARK) & (values < level)]
        if len(values) >= _LEAST_PILE:
            shares.append(np.unique(values, return_counts=True)[1].max() / len(values))
            low, middle, high = np.quantile(values, (0.05, 0.5, 0.95))
            spreads.append(1.0 if middle < level / _GLOSS else (high - low) / level)
        if len(shares) == _WITNESSES:
            break
    if not shares:
        return False
    # An uneven area that faces a light has equal samples too, where it is tilted by less than
    # sqrt(2 step / level); under other lights, its samples then differ by twice this at most.
    uneven = 2 * np.sqrt(2 * histogram.step_below(level) / level)
    return bool(np.median(shares) < _SAME and np.median(spreads) > uneven)
