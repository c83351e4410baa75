"""Compiled copies of a rectangle over a larger area: which copy each pixel belongs to."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from processing._cuts.minimum_cuts import taken_pixels

# Compiled in: processing/_cuts/minimum_cuts.py 599a21c2471f
Float = npt.NDArray[np.float32]
Whole = npt.NDArray[np.int32]
Mask = npt.NDArray[np.bool_]


@numba.njit(cache=True)
def cut_row(rectangle: Float, overlaps: tuple[int, int], row: int, copies: Whole) -> None:
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
def lay(
    normals: Float,
    mask: Mask,
    room: Mask,
    copies: Whole,
    row: int,
    across: int,
    source: tuple[int, int, int],
    stride: int,
    left: int,
    mirrored: bool,
    out: Float,
    known: Mask,
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
