"""Means over the pixels around each pixel."""

from __future__ import annotations

import cv2
import numpy as np

from rig.arrays import Bool, Float32


def sum_around(values: Float32, across: int) -> Float32:
    """Return the sums of a map over squares of so many pixels across."""
    border = cv2.BORDER_CONSTANT
    found = cv2.boxFilter(values, -1, (across, across), normalize=False, borderType=border)
    return np.asarray(found)


def mean_around(values: Float32, inside: Bool, across: int) -> Float32:
    """Return the means of a map, which is 0 outside of a mask, over the pixels inside; 0 outside.

    Parameters
    ----------
    values
        ``(H, W)``.
    inside
        ``(H, W)`` bool.
    across
        Width and height of the squares.
    """
    count = sum_around(inside.astype(np.float32), across)
    mean = sum_around(values, across) / np.maximum(count, 1)
    return np.asarray(np.where(inside, mean, 0), np.float32)
