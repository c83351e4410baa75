"""Placement of a part of a source on a target."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from acquisition import DataError
from processing._detail.copies import cut_copies, lay
from processing._detail.tile import TILES, Tile
from processing._normal_map import NormalMap

Whole = npt.NDArray[np.int32]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
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
    overlaps
        Columns and rows by which neighbouring copies overlap; 0 if they are not cut.
    mirrored
        Whether every second copy is mirrored along its axis.
    copies
        ``(h, w)`` int32: number of the copy, in reading order, at each pixel of the area that
        starts at `at`.
    """

    source_window: tuple[int, int, int, int]
    at: tuple[int, int]
    tiles: tuple[int, int]
    overlaps: tuple[int, int]
    mirrored: bool
    copies: Whole

    def __repr__(self) -> str:
        used = f"source_window={self.source_window}, at={self.at}, tiles={self.tiles}"
        return f"Placement({used}, overlaps={self.overlaps}, mirrored={self.mirrored})"

    def place(self, detail: NormalMap, target: NormalMap) -> NormalMap:
        """Place a source's detail on a target; known where both target and detail are known."""
        _, _, width, height = self.source_window
        strides = width - self.overlaps[0], height - self.overlaps[1]
        normals, mask = lay(
            detail.normals, detail.mask, target.mask, self.copies, self.source_window, self.at,
            strides, self.tiles[0], self.mirrored,
        )  # fmt: skip
        return NormalMap(normals, mask)

    def labels(self, size: tuple[int, int]) -> Whole:
        """Return the number of the copy at each pixel of a target, -1 outside the area."""
        found = np.full(size, -1, np.int32)
        x, y = self.at
        rows, columns = self.copies.shape
        part = self.copies[max(-y, 0) : size[0] - y, max(-x, 0) : size[1] - x]
        found[max(y, 0) : max(y + rows, 0), max(x, 0) : max(x + columns, 0)] = part
        return found


def cover(detail: NormalMap, target_mask: Mask, tile: Tile) -> Placement:
    """Cover a target's mask with the largest rectangle inside a source's mask.

    Parameters
    ----------
    detail
        The detail of the source.
    target_mask
        ``(H, W)`` bool, not empty; the size may differ.
    tile
        How copies of the rectangle are joined.

    Returns
    -------
    Placement
        Along each axis: if the rectangle is at least as long as the target's bounding box, its
        middle part; otherwise the rectangle is repeated, starting at the first pixel of the box.
        Copies that are cut overlap by a third of the shorter side of the rectangle.

    Raises
    ------
    DataError
        If `tile` is unknown.
    """
    if tile not in TILES:
        raise DataError(f"unknown way of tiling {tile!r}: use {', '.join(TILES)}")
    x, y, width, height = largest_rectangle(detail.mask)
    rows, columns = np.flatnonzero(target_mask.any(axis=1)), np.flatnonzero(target_mask.any(axis=0))
    first_row, first_column = int(rows[0]), int(columns[0])
    need = int(rows[-1]) + 1 - first_row, int(columns[-1]) + 1 - first_column
    overlap = min(width, height) // 3 if tile == "cut" else 0
    overlap = overlap if overlap > 1 else 0
    x, width, across, over = _along(x, width, need[1], overlap)
    y, height, down, under = _along(y, height, need[0], overlap)
    if overlap:
        rectangle = np.ascontiguousarray(detail.normals[y : y + height, x : x + width])
        copies = cut_copies(rectangle, need, (under, over))
    else:
        number = np.arange(need[0]) // height * across
        copies = (number[:, None] + np.arange(need[1]) // width).astype(np.int32)
    return Placement(
        (x, y, width, height), (first_column, first_row), (across, down), (over, under),
        tile == "mirror", copies,
    )  # fmt: skip


def _along(start: int, length: int, need: int, overlap: int) -> tuple[int, int, int, int]:
    """Return first pixel, length, number and overlap of the copies along one axis."""
    if length >= need:
        return start + (length - need) // 2, need, 1, 0
    return start, length, -(-(need - overlap) // (length - overlap)), overlap


def place_at(source: NormalMap, target: NormalMap, at: tuple[int, int]) -> Placement:
    """Place a source's first pixel on a pixel (column, row) of the target.

    Raises
    ------
    DataError
        If no pixel of the source's mask is placed inside the target's mask.
    """
    height, width = source.size
    x, y = int(at[0]), int(at[1])
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
    copies = np.zeros((height, width), np.int32)
    return Placement((0, 0, width, height), (x, y), (1, 1), (0, 0), mirrored=False, copies=copies)


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
