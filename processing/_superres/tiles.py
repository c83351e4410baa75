"""Tiles of an image, with halos."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Window = tuple[slice, slice]


class Tile(NamedTuple):
    """A part of an image, and the larger part on which its result depends.

    Parameters
    ----------
    core
        The part itself, in pixels of the image.
    around
        The part with its halo, cut at the border of the image.
    inside
        The core, in pixels of `around`.
    """

    core: Window
    around: Window
    inside: Window


def tiles(mask: npt.NDArray[np.bool_], side: int, halo: int) -> Iterator[Tile]:
    """Yield the tiles of an image that contain pixels of a mask.

    Parameters
    ----------
    mask
        ``(h, w)`` bool.
    side, halo
        Side of the cores, and width of the halo around them.
    """
    for row in range(0, mask.shape[0], side):
        for column in range(0, mask.shape[1], side):
            spans = [
                _span(first, side, halo, length)
                for first, length in zip((row, column), mask.shape, strict=True)
            ]
            core = spans[0][0], spans[1][0]
            if mask[core].any():
                yield Tile(core, (spans[0][1], spans[1][1]), (spans[0][2], spans[1][2]))


def enlarged_window(window: Window, scale: int) -> Window:
    """Return a window in pixels of a resolution that is higher by a factor."""
    rows, columns = (slice(part.start * scale, part.stop * scale) for part in window)
    return rows, columns


def _span(first: int, side: int, halo: int, length: int) -> tuple[slice, slice, slice]:
    last = min(first + side, length)
    begin, end = max(first - halo, 0), min(last + halo, length)
    return slice(first, last), slice(begin, end), slice(first - begin, last - begin)
