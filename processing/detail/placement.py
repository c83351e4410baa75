"""Placement of a part of a source on a target."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from acquisition import DataError, MapRows
from acquisition.files import ComputedRows, MapToFill
from processing.detail.choices import TILES, Tile
from processing.detail.minimum_cuts import taken_pixels
from processing.maps.mask import bounding_box
from processing.maps.normal_map import NormalMap
from rig.arrays import Bool, Float32, Int32

# Compiled in: processing/detail/minimum_cuts.py 595407bbeb71


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
        starts at `at`; an array, or a map whose rows are read or computed.
    """

    source_window: tuple[int, int, int, int]
    at: tuple[int, int]
    tiles: tuple[int, int]
    overlaps: tuple[int, int]
    mirrored: bool
    copies: MapRows

    def __repr__(self) -> str:
        used = f"source_window={self.source_window}, at={self.at}, tiles={self.tiles}"
        return f"Placement({used}, overlaps={self.overlaps}, mirrored={self.mirrored})"

    def place(self, detail: NormalMap, target: NormalMap) -> NormalMap:
        """Place a source's detail on a target; known where both target and detail are known."""
        everywhere = slice(0, len(target.mask))
        return NormalMap(*self.place_rows(detail.normals, detail.mask, target.mask, everywhere))

    def place_rows(
        self, normals: MapRows, mask: Bool, room: Bool, rows: slice
    ) -> tuple[Float32, Bool]:
        """Place a source's detail on some rows of a target.

        Parameters
        ----------
        normals, mask
            ``(h, w, 3)`` and ``(h, w)``: the detail, of which only the required rows are read.
        room
            ``(H, W)`` bool, the pixels of the target that may receive a normal.
        rows
            Rows of the target, with start and stop.

        Returns
        -------
        normals, known
            ``(rows, W, 3)`` float32, 0 where nothing is placed, and ``(rows, W)`` bool.
        """
        x, y, width, height = self.source_window
        count, columns = rows.stop - rows.start, room.shape[1]
        out, known = np.zeros((count, columns, 3), np.float32), np.zeros((count, columns), np.bool_)
        # In rows of the area.
        first = max(rows.start - self.at[1], 0)
        last = min(rows.stop - self.at[1], self.copies.shape[0])
        stride = height - self.overlaps[1]
        for i in range(max((first - height) // stride, 0), self.tiles[1]):
            top, bottom = max(first, i * stride), min(last, i * stride + height)
            if top >= bottom:
                continue
            upside_down = self.mirrored and i % 2 == 1
            begin = i * stride + height - bottom if upside_down else top - i * stride
            of_source = slice(y + begin, y + begin + bottom - top)
            of_target = slice(self.at[1] + top, self.at[1] + bottom)
            to = slice(of_target.start - rows.start, of_target.stop - rows.start)
            _lay(
                np.ascontiguousarray(normals[of_source]), np.ascontiguousarray(mask[of_source]),
                np.ascontiguousarray(room[of_target]), self._copies(slice(top, bottom)), i,
                self.tiles[0], (x, width, upside_down), width - self.overlaps[0], self.at[0],
                self.mirrored, out[to], known[to],
            )  # fmt: skip
        return out, known

    def _copies(self, rows: slice) -> Int32:
        return np.ascontiguousarray(self.copies[rows][:, : self.copies.shape[1]], np.int32)

    def labels(self, size: tuple[int, int]) -> Int32:
        """Return the number of the copy at each pixel of a target, -1 outside the area."""
        return self.label_rows(slice(0, size[0]), size[1])

    def label_rows(self, rows: slice, width: int) -> Int32:
        """Return the number of the copy at each pixel of some rows of a target, -1 outside."""
        found = np.full((rows.stop - rows.start, width), -1, np.int32)
        x, y = self.at
        first, last = max(rows.start - y, 0), min(rows.stop - y, self.copies.shape[0])
        if first < last:
            part = self._copies(slice(first, last))[:, max(-x, 0) : max(width - x, 0)]
            left, top = max(x, 0), y + first - rows.start
            found[top : top + len(part), left : left + part.shape[1]] = part
        return found


@dataclass(frozen=True)
class Cover:
    """How copies of a rectangle of a source cover the bounding box of a target.

    Parameters
    ----------
    window
        (column, row, width, height) of the rectangle in the source.
    at, size
        (column, row) of the area in the target, and its (height, width).
    tiles, overlaps
        Number of copies, and columns and rows by which they overlap (across, down).
    """

    window: tuple[int, int, int, int]
    at: tuple[int, int]
    size: tuple[int, int]
    tiles: tuple[int, int]
    overlaps: tuple[int, int]

    @classmethod
    def of(cls, source_mask: Bool, target_mask: Bool, tile: Tile) -> Cover:
        """Return the way in which the largest rectangle inside a mask covers another mask.

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
        x, y, width, height = largest_rectangle(source_mask)
        rows, columns = bounding_box(target_mask)
        need = rows.stop - rows.start, columns.stop - columns.start
        overlap = min(width, height) // 3 if tile == "cut" else 0
        overlap = overlap if overlap > 1 else 0
        x, width, across, over = _along(x, width, need[1], overlap)
        y, height, down, under = _along(y, height, need[0], overlap)
        window, at = (x, y, width, height), (columns.start, rows.start)
        return cls(window, at, need, (across, down), (over, under))

    @property
    def is_cut(self) -> bool:
        """Whether copies overlap, so that cuts have to be found."""
        return self.overlaps != (0, 0)

    def cut(self, normals: MapRows, copies: MapToFill) -> None:
        """Find the cuts between copies of a detail, one row of copies after the other.

        Parameters
        ----------
        normals
            ``(h, w, 3)``: the detail of the source, of which the rectangle is read.
        copies
            ``(H, W)`` int32 of at least the size of the area: written.
        """
        x, y, width, height = self.window
        rectangle = np.ascontiguousarray(normals[y : y + height][:, x : x + width], np.float32)
        (rows, columns), stride = self.size, height - self.overlaps[1]
        above = np.zeros((0, columns), np.int32)
        for i in range(self.tiles[1]):
            top = i * stride
            part = np.zeros((min(height, rows - top), columns), np.int32)
            part[: len(above)] = above
            _cut_row(rectangle, (self.overlaps[1], self.overlaps[0]), i, part)
            written = part
            if columns < copies.shape[1]:
                written = np.zeros((len(part), copies.shape[1]), np.int32)
                written[:, :columns] = part
            copies[top : top + len(part)] = written
            above = part[stride:]

    def placement(self, tile: Tile, copies: MapRows | None) -> Placement:
        """Return the placement; ``copies`` are those of `cut`, None if nothing is cut."""
        (rows, columns), (_, _, width, height) = self.size, self.window

        def numbers(part: slice) -> Int32:
            down = np.arange(part.start, part.stop) // height * self.tiles[0]
            return (down[:, None] + np.arange(columns) // width).astype(np.int32)

        def cut(part: slice) -> Int32:
            found: Int32 = (numbers if copies is None else copies.__getitem__)(part)[:, :columns]
            return found

        known = ComputedRows((rows, columns), np.dtype(np.int32), cut)
        return Placement(self.window, self.at, self.tiles, self.overlaps, tile == "mirror", known)


def _along(start: int, length: int, need: int, overlap: int) -> tuple[int, int, int, int]:
    """Return first pixel, length, number and overlap of the copies along one axis."""
    if length >= need:
        return start + (length - need) // 2, need, 1, 0
    return start, length, -(-(need - overlap) // (length - overlap)), overlap


def place_at(source_mask: Bool, target_mask: Bool, at: tuple[int, int]) -> Placement:
    """Place a source's first pixel on a pixel (column, row) of the target.

    Raises
    ------
    DataError
        If no pixel of the source's mask is placed inside the target's mask.
    """
    height, width = source_mask.shape
    x, y = int(at[0]), int(at[1])
    top, left = max(y, 0), max(x, 0)
    bottom, right = min(y + height, target_mask.shape[0]), min(x + width, target_mask.shape[1])
    overlap = (
        bottom > top
        and right > left
        and np.any(
            target_mask[top:bottom, left:right]
            & source_mask[top - y : bottom - y, left - x : right - x]
        )
    )
    if not overlap:
        raise DataError(
            f"a source of {width} x {height} pixels put at {x},{y} does not reach the mask of the "
            f"target of {target_mask.shape[1]} x {target_mask.shape[0]}: choose another place"
        )
    window, one = (0, 0, width, height), (height, width)
    return Cover(window, (x, y), one, (1, 1), (0, 0)).placement("plain", None)


def largest_rectangle(mask: Bool) -> tuple[int, int, int, int]:
    """Return (column, row, width, height) of the largest rectangle inside a mask.

    If several are equally large, the first in reading order of the lower right corners is returned.
    Width and height are 0 if the mask is empty.
    """
    x, y, width, height = _largest_rectangle(mask)
    return int(x), int(y), int(width), int(height)


@numba.njit(cache=True)
def _largest_rectangle(mask: Bool) -> tuple[int, int, int, int]:
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


@numba.njit(cache=True)
def _cut_row(rectangle: Float32, overlaps: tuple[int, int], row: int, copies: Int32) -> None:
    """Place one row of overlapping copies of a rectangle, joined along minimum-error cuts.

    Parameters
    ----------
    rectangle
        ``(h, w, 3)`` vectors.
    overlaps
        Rows and columns by which neighbouring copies overlap, each 0 or more than 1, and less than
        the rectangle has.
    row
        Number of the row of copies.
    copies
        ``(up to h, width)`` number of the copy that each pixel belongs to, in reading order. On
        entry, the first rows contain the numbers of the row of copies above.
    """
    rows, columns = copies.shape
    down, right = rectangle.shape[0] - overlaps[0], rectangle.shape[1] - overlaps[1]
    across = (max(columns - overlaps[1], 1) + right - 1) // right
    for j in range(across):
        left = j * right
        width = min(rectangle.shape[1], columns - left)
        bands = (overlaps[1] if left else 0, overlaps[0] if row else 0, 0, 0)
        # What the cuts compare: the pixels that another copy has there.
        there = np.zeros((rows, width, 3), np.float32)
        for r in range(rows):
            known = width if r < bands[1] else min(bands[0], width)
            for c in range(known):
                above, before = divmod(copies[r, left + c], across)
                for k in range(3):
                    there[r, c, k] = rectangle[
                        r + (row - above) * down, c + (j - before) * right, k
                    ]
        new = np.ascontiguousarray(rectangle[:rows, :width])
        taken = taken_pixels(there, new, bands)
        for r in range(rows):
            for c in range(width):
                if taken[r, c]:
                    copies[r, left + c] = row * across + j


@numba.njit(cache=True)
def _lay(
    normals: Float32,
    mask: Bool,
    room: Bool,
    copies: Int32,
    row: int,
    across: int,
    source: tuple[int, int, int],
    stride: int,
    left: int,
    mirrored: bool,
    out: Float32,
    known: Bool,
) -> None:
    """Fill the pixels of one row of copies in some rows of a target.

    Parameters
    ----------
    normals, mask
        Rows of the source: for each row of the target the one that this row of copies has there.
    room
        ``(n, W)`` bool, the pixels of the target that may receive a normal.
    copies
        ``(n, w)`` number of the copy at each pixel of the area.
    row, across
        Number of the row of copies, and copies in a row.
    source
        First column and width of the window of the source, and whether its rows are upside down.
    stride, left
        Columns from copy to copy, and column of the target at which the area starts, which may be
        outside.
    mirrored
        Whether every second copy is mirrored along its axis, with its normals.
    out, known
        ``(n, W, 3)`` and ``(n, W)``, written where the copies are those of the row.
    """
    x, width, upside_down = source
    sign_y = np.float32(-1) if upside_down else np.float32(1)
    for r in range(room.shape[0]):
        q = room.shape[0] - 1 - r if upside_down else r
        for c in range(max(left, 0), min(left + copies.shape[1], room.shape[1])):
            i, j = divmod(copies[r, c - left], across)
            if i != row:
                continue
            d, sign_x = c - left - j * stride, np.float32(1)
            if mirrored and j % 2:
                d, sign_x = width - 1 - d, np.float32(-1)
            d += x
            if room[r, c] and mask[q, d]:
                known[r, c] = True
                out[r, c, 0] = sign_x * normals[q, d, 0]
                out[r, c, 1] = sign_y * normals[q, d, 1]
                out[r, c, 2] = normals[q, d, 2]
