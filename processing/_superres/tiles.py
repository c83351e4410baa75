"""Tiles of an image, with halos, in rows from the top downwards."""

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


class Span(NamedTuple):
    """Some of the rows or columns of an image, as in `Tile`."""

    core: slice
    around: slice
    inside: slice


def spans(length: int, side: int, halo: int) -> list[Span]:
    """Return the parts of the rows or columns of an image.

    Parameters
    ----------
    length
        Number of rows or columns.
    side, halo
        Length of the parts, and width of the halo around them.
    """
    made = []
    for first in range(0, length, side):
        last = min(first + side, length)
        begin, end = max(first - halo, 0), min(last + halo, length)
        core, inside = slice(first, last), slice(first - begin, last - begin)
        made.append(Span(core, slice(begin, end), inside))
    return made


def tiles(reach: npt.NDArray[np.bool_], rows: slice, side: int, halo: int) -> Iterator[Tile]:
    """Yield the tiles of one row of tiles that contain pixels of a mask.

    Parameters
    ----------
    reach
        ``(h, w)`` bool, of the rows with their halo.
    rows
        The rows of the cores.
    side, halo
        Width of the cores, and width of the halo around them.
    """
    for columns in spans(reach.shape[1], side, halo):
        core = rows, columns.core
        if reach[core].any():
            yield Tile(core, (slice(0, len(reach)), columns.around), (rows, columns.inside))


def enlarged_window(window: Window, scale: int) -> Window:
    """Return a window in pixels of a resolution that is higher by a factor."""
    rows, columns = (enlarged_rows(part, scale) for part in window)
    return rows, columns


def enlarged_rows(rows: slice, scale: int) -> slice:
    """Return rows in pixels of a resolution that is higher by a factor."""
    return slice(rows.start * scale, rows.stop * scale)
