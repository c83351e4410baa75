"""Placement of a part of a source on a target."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from acquisition import DataError
from processing._normal_map import NormalMap

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Placement:
    """The position of the pixels of a source on a target, without resampling.

    Parameters
    ----------
    source_window
        (column, row, width, height) of the part of the source that is used.
    at
        (column, row) of the target at which the first pixel of the window is placed.
    tiles
        Number of copies of the window (across, down).
    """

    source_window: tuple[int, int, int, int]
    at: tuple[int, int]
    tiles: tuple[int, int]

    def place(self, detail: NormalMap, target: NormalMap) -> NormalMap:
        """Place a source's detail on a target; known where both target and detail are known."""
        normals, mask = _lay(
            detail.normals, detail.mask, target.mask, self.source_window, self.at, self.tiles
        )
        return NormalMap(normals, mask)


@numba.njit(cache=True)
def _lay(
    normals: npt.NDArray[np.float32],
    mask: Mask,
    room: Mask,
    window: tuple[int, int, int, int],
    at: tuple[int, int],
    tiles: tuple[int, int],
) -> tuple[npt.NDArray[np.float32], Mask]:
    rows, columns = room.shape
    out = np.zeros((rows, columns, 3), np.float32)
    known = np.zeros((rows, columns), np.bool_)
    x, y, width, height = window
    left, right = max(at[0], 0), min(at[0] + width * tiles[0], columns)
    for r in range(max(at[1], 0), min(at[1] + height * tiles[1], rows)):
        q = y + (r - at[1]) % height
        d = x + (left - at[0]) % width
        for c in range(left, right):
            if room[r, c] and mask[q, d]:
                known[r, c] = True
                for k in range(3):
                    out[r, c, k] = normals[q, d, k]
            d = d + 1 if d + 1 < x + width else x
    return out, known


def fill(source_mask: Mask, target_mask: Mask) -> Placement:
    """Cover a target's mask with the largest rectangle inside a source's mask.

    Parameters
    ----------
    source_mask, target_mask
        ``(H, W)`` bool, not empty; the sizes may differ.

    Returns
    -------
    Placement
        Along each axis: if the rectangle is at least as long as the target's bounding box, its
        middle part; otherwise the rectangle is repeated, starting at the first pixel of the box.
    """
    x, y, width, height = largest_rectangle(source_mask)
    rows, columns = np.flatnonzero(target_mask.any(axis=1)), np.flatnonzero(target_mask.any(axis=0))
    first_row, first_column = int(rows[0]), int(columns[0])
    need_height, need_width = int(rows[-1]) + 1 - first_row, int(columns[-1]) + 1 - first_column
    x, width, across = _cut(x, width, need_width)
    y, height, down = _cut(y, height, need_height)
    return Placement((x, y, width, height), (first_column, first_row), (across, down))


def _cut(start: int, length: int, need: int) -> tuple[int, int, int]:
    if length >= need:
        return start + (length - need) // 2, need, 1
    return start, length, -(-need // length)


def place_at(source: NormalMap, target: NormalMap, at: tuple[int, int]) -> Placement:
    """Place a source's first pixel on a pixel (column, row) of the target.

    Raises
    ------
    DataError
        If no pixel of the source's mask is placed inside the target's mask.
    """
    height, width = source.size
    placement = Placement((0, 0, width, height), (int(at[0]), int(at[1])), (1, 1))
    x, y = placement.at
    top, left = max(y, 0), max(x, 0)
    bottom, right = min(y + height, target.size[0]), min(x + width, target.size[1])
    overlap = (
        bottom > top
        and right > left
        and np.any(
            target.mask[top:bottom, left:right]
            & source.mask[top - y : bottom - y, left - x : right - x]
        )
    )
    if not overlap:
        raise DataError(
            f"a source of {width} x {height} pixels put at {x},{y} does not reach the mask of the "
            f"target of {target.size[1]} x {target.size[0]}: choose another place"
        )
    return placement


def largest_rectangle(mask: Mask) -> tuple[int, int, int, int]:
    """Return (column, row, width, height) of the largest rectangle inside a mask.

    If several are equally large, the first in reading order of the lower right corners is returned.
    Width and height are 0 if the mask is empty.
    """
    x, y, width, height = _largest_rectangle(mask)
    return int(x), int(y), int(width), int(height)


@numba.njit(cache=True)
def _largest_rectangle(mask: Mask) -> tuple[int, int, int, int]:
    # Find the largest rectangle in each row's histogram of vertical pixel runs with a stack of
    # increasing bars: each bar is pushed and popped once.
    rows, columns = mask.shape
    above = np.zeros(columns + 1, np.int64)
    left = np.zeros(columns + 1, np.int64)
    tall = np.zeros(columns + 1, np.int64)
    best, x, y, width, height = 0, 0, 0, 0, 0
    for r in range(rows):
        depth = 0
        for c in range(columns + 1):
            if c < columns:
                above[c] = above[c] + 1 if mask[r, c] else 0
            start = c
            while depth and tall[depth - 1] >= above[c]:
                depth -= 1
                start = left[depth]
                area = tall[depth] * (c - start)
                if area > best:
                    best = area
                    x, y = start, r + 1 - tall[depth]
                    width, height = c - start, tall[depth]
            left[depth], tall[depth] = start, above[c]
            depth += 1
    return x, y, width, height
