"""Compiled loops over pixels of blocks."""

from __future__ import annotations

import numba
import numpy as np

from rig.arrays import Float64, Int32, Int64


@numba.njit(cache=True)
def number_parts(
    u: Float64, labels: Int32, part_of: Int32, number: Int32, sums: Float64, sizes: Int64
) -> None:
    """Replace parts of blocks by parts of the surface, and add up the values of each part.

    Parameters
    ----------
    u
        ``(h, W)`` values.
    labels
        ``(h, W)`` part of a block, -1 for none; replaced by the number of the part of the surface.
    part_of
        Part of the surface of each part of a block.
    number
        Number of each part in reading order; -1 for those that were not seen yet.
    sums, sizes
        Sum of the values and number of pixels of each part, by its number; added to.
    """
    count = 0
    for part in range(len(number)):
        count = max(count, number[part] + 1)
    for r in range(labels.shape[0]):
        for c in range(labels.shape[1]):
            if labels[r, c] < 0:
                continue
            part = part_of[labels[r, c]]
            if number[part] < 0:
                number[part] = count
                count += 1
            labels[r, c] = number[part]
            sums[number[part]] += u[r, c]
            sizes[number[part]] += 1


@numba.njit(cache=True)
def extremes(u: Float64, labels: Int32, count: int) -> Float64:
    """Return ``(2, count)`` smallest and largest values of each part; inf and -inf without any."""
    found = np.full((2, count), np.inf)
    found[1] = -np.inf
    for r in range(labels.shape[0]):
        for c in range(labels.shape[1]):
            part = labels[r, c]
            if part >= 0:
                found[0, part] = min(found[0, part], u[r, c])
                found[1, part] = max(found[1, part], u[r, c])
    return found
