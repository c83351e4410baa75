"""Samples that pile up at their largest value, because they were clipped there.

The largest value of a recording is a pile-up if many samples are equal to it, far more than to any
value just below. An even area that is the brightest of the scene looks the same without noise, so
other images decide: samples that are equal because they were clipped differ under other lights.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from acquisition._pixels.images import Image

Plane = npt.NDArray[np.generic]
Reader = Callable[[], Image | None]

# The values just below are those within a 64th, at least four. The most frequent one counts: the
# largest value of a smooth surface without noise occurs 2.4 times as often as the next, at most.
_NEAR: Final = 64
_LEAST_NEAR: Final = 4
_PILE: Final = 4
_LEAST_PILE: Final = 16
# Largest values of converters; there no other image has to decide.
_CONVERTER_ENDS: Final = (2**10 - 1, 2**12 - 1, 2**14 - 1)
# Samples of a pile-up in another image say nothing if they are in shadow, darker than an eighth.
# An even area has one value there; half of the samples allow for gloss and few grey values.
_DARK: Final = 8
_SAME: Final = 0.5
_WITNESSES: Final = 8
# Images in memory at a time.
_THREADS: Final = 4


class PileUp(NamedTuple):
    """Values at which samples were clipped.

    Parameters
    ----------
    levels
        The value by plane (see `planes_of`), NaN where nothing is clipped.
    tops
        The largest value by plane.
    samples
        Number of clipped samples.
    """

    levels: tuple[float, ...]
    tops: tuple[float, ...]
    samples: int


def planes_of(pixels: Image, side: int) -> list[Plane]:
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
    tops: list[_Top] = []
    with ThreadPoolExecutor(_THREADS) as pool:
        for first in range(0, len(images), _THREADS):
            numbers = range(first, min(first + _THREADS, len(images)))
            for found in pool.map(partial(_tops_of, images, side), numbers):
                joined = [one.joined(two) for one, two in zip(tops, found, strict=False)]
                tops = joined or tops or found
            if tops and all(top.value >= white for top in tops):
                return None
    piled = [top.value < white and top.is_pile for top in tops]
    for index, top in enumerate(tops):
        if piled[index] and top.value not in _CONVERTER_ENDS:
            piled[index] = _varies(images, side, index, top)
    if not any(piled):
        return None
    return PileUp(
        tuple(top.value if pile else np.nan for top, pile in zip(tops, piled, strict=True)),
        tuple(top.value for top in tops),
        sum(top.count for top, pile in zip(tops, piled, strict=True) if pile),
    )


@dataclass(frozen=True)
class _Top:
    """The largest value of a plane, and how often it and values just below occur.

    ``most`` is the number of its samples in the image ``image``, which has more than others.
    """

    value: float
    values: npt.NDArray[np.generic]
    counts: npt.NDArray[np.int64]
    image: int
    most: int

    @property
    def count(self) -> int:
        return int(self.counts[-1])

    @property
    def is_pile(self) -> bool:
        below = int(self.counts[:-1].max(initial=0))
        return self.count >= max(_LEAST_PILE, _PILE * below)

    @property
    def is_approached(self) -> bool:
        """Whether samples have values just below, as those of a scene in which some are clipped."""
        return len(self.counts) > 1

    def joined(self, other: _Top) -> _Top:
        """Return the values of both; those of a darker image do not count."""
        if self.value != other.value:
            return max(self, other, key=lambda top: top.value)
        values, place = np.unique(np.concatenate([self.values, other.values]), return_inverse=True)
        counts = np.zeros(len(values), np.int64)
        np.add.at(counts, place, np.concatenate([self.counts, other.counts]))
        first = self if self.most >= other.most else other
        return _Top(self.value, values, counts, first.image, first.most)


def _tops_of(images: Sequence[Reader], side: int, image: int) -> list[_Top]:
    pixels = images[image]()
    if pixels is None or not pixels.size:
        return []
    return [_top_of(plane, image) for plane in planes_of(pixels, side)]


def _top_of(plane: Plane, image: int) -> _Top:
    top = plane.max(initial=0)
    if plane.dtype.kind == "f":
        values, counts = np.unique(plane[plane >= top - top / _NEAR], return_counts=True)
        # Values that occur once are as many as samples; one of them is enough.
        kept = counts > 1
        kept[[0, -1]] = True
        values, counts = values[kept], counts[kept]
    else:
        low = max(int(top) - max(int(top) // _NEAR, _LEAST_NEAR), 0)
        counts = np.bincount((plane[plane >= low] - low).ravel(), minlength=int(top) - low + 1)
        values = low + np.flatnonzero(counts)
        counts = counts[counts > 0]
    return _Top(float(top), values, counts.astype(np.int64), image, int(counts[-1]))


def _varies(images: Sequence[Reader], side: int, index: int, top: _Top) -> bool:
    """Return whether samples that are equal in the pile-up of one image differ in others."""
    pixels = images[top.image]()
    if pixels is None or not top.is_approached:
        return False
    pile = planes_of(pixels, side)[index] == top.value
    shares: list[float] = []
    for other in _others(images, top.image):
        values = planes_of(other, side)[index][pile]
        values = values[(values > top.value / _DARK) & (values < top.value)]
        if len(values) >= _LEAST_PILE:
            shares.append(np.unique(values, return_counts=True)[1].max() / len(values))
        if len(shares) == _WITNESSES:
            break
    return bool(shares) and float(np.median(shares)) < _SAME


def _others(images: Sequence[Reader], without: int) -> Iterator[Image]:
    for number, read in enumerate(images):
        pixels = None if number == without else read()
        if pixels is not None:
            yield pixels
