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
def cut_copies(rectangle: Float, size: tuple[int, int], overlaps: tuple[int, int]) -> Whole:
    """Cover an area with overlapping copies of a rectangle, joined along minimum-error cuts.

    Parameters
    ----------
    rectangle
        ``(h, w, 3)`` vectors.
    size
        (height, width) of the area.
    overlaps
        Rows and columns by which neighbouring copies overlap, each 0 or more than 1, and less than
        the rectangle has.

    Returns
    -------
    Whole
        ``(height, width)`` number of the copy that each pixel belongs to, in reading order.
    """
    rows, columns = size
    down, right = rectangle.shape[0] - overlaps[0], rectangle.shape[1] - overlaps[1]
    area = np.zeros((rows, columns, 3), np.float32)
    copies = np.zeros((rows, columns), np.int32)
    number = 0
    for top in range(0, max(rows - overlaps[0], 1), down):
        for left in range(0, max(columns - overlaps[1], 1), right):
            height = min(rectangle.shape[0], rows - top)
            width = min(rectangle.shape[1], columns - left)
            there = np.ascontiguousarray(area[top : top + height, left : left + width])
            new = np.ascontiguousarray(rectangle[:height, :width])
            bands = (overlaps[1] if left else 0, overlaps[0] if top else 0, 0, 0)
            taken = taken_pixels(there, new, bands)
            for r in range(height):
                for c in range(width):
                    if taken[r, c]:
                        copies[top + r, left + c] = number
                        for k in range(3):
                            area[top + r, left + c, k] = new[r, c, k]
            number += 1
    return copies


@numba.njit(cache=True)
def lay(
    normals: Float,
    mask: Mask,
    room: Mask,
    copies: Whole,
    window: tuple[int, int, int, int],
    at: tuple[int, int],
    strides: tuple[int, int],
    across: int,
    mirrored: bool,
) -> tuple[Float, Mask]:
    """Fill an area of a target with copies of a window of a source.

    Parameters
    ----------
    normals, mask
        The source.
    room
        ``(H, W)`` bool, the pixels of the target that may receive a normal.
    copies
        ``(h, w)`` number of the copy at each pixel of the area.
    window
        (column, row, width, height) of the source.
    at
        (column, row) of the area's first pixel in the target, which may be outside.
    strides, across
        Columns and rows from copy to copy, and the number of copies in a row.
    mirrored
        Whether every second copy is mirrored along its axis, with its normals.
    """
    rows, columns = room.shape
    out = np.zeros((rows, columns, 3), np.float32)
    known = np.zeros((rows, columns), np.bool_)
    x, y, width, height = window
    left, right = max(at[0], 0), min(at[0] + copies.shape[1], columns)
    for r in range(max(at[1], 0), min(at[1] + copies.shape[0], rows)):
        for c in range(left, right):
            i, j = divmod(copies[r - at[1], c - at[0]], across)
            q, d = r - at[1] - i * strides[1], c - at[0] - j * strides[0]
            sign_x, sign_y = np.float32(1), np.float32(1)
            if mirrored and i % 2:
                q, sign_y = height - 1 - q, np.float32(-1)
            if mirrored and j % 2:
                d, sign_x = width - 1 - d, np.float32(-1)
            q, d = q + y, d + x
            if room[r, c] and mask[q, d]:
                known[r, c] = True
                out[r, c, 0] = sign_x * normals[q, d, 0]
                out[r, c, 1] = sign_y * normals[q, d, 1]
                out[r, c, 2] = normals[q, d, 2]
    return out, known
