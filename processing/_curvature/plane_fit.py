"""Planes fitted to values around each pixel, with Gaussian weights inside a mask."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

Double = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# The weights end at this many times the scale.
_REACH = 4.0
# Smallest variance of the positions along any direction, relative to that of a complete window;
# half of a window has 0.36.
_LEAST_SPREAD = 0.05


@dataclass(frozen=True, eq=False)
class Planes:
    """Planes ``value + right * x + up * y`` of C values around each pixel, x and y in pixels.

    Parameters
    ----------
    value, right, up
        ``(C, H, W)`` float64.
    known
        ``(H, W)`` bool, where the pixels of the mask determine them.
    """

    value: Double
    right: Double
    up: Double
    known: Mask


def reach(scale_px: float) -> int:
    """Return how many pixels around one take part in its fit."""
    return max(1, int(np.ceil(_REACH * scale_px)))


def fit_planes(values: Double, mask: Mask, scale_px: float) -> Planes:
    """Fit planes by least squares with the weights ``exp(-(x^2 + y^2) / (2 scale^2))``.

    Parameters
    ----------
    values
        ``(C, H, W)`` float64, finite inside the mask.
    mask
        ``(H, W)`` bool; other pixels have no weight.
    scale_px
        Standard deviation of the weights in pixels.
    """
    offset = np.arange(-reach(scale_px), reach(scale_px) + 1, dtype=np.float64)
    weight = np.exp(-0.5 * (offset / scale_px) ** 2)
    weight /= weight.sum()
    # Rows run down, y is up.
    across = [weight * offset**power for power in range(3)]
    along = [weight * (-offset) ** power for power in range(3)]

    def moment(image: Double, x: int, y: int) -> Double:
        filtered = cv2.sepFilter2D(
            image, cv2.CV_64F, across[x], along[y], borderType=cv2.BORDER_CONSTANT
        )
        return np.asarray(filtered, np.float64)

    inside = mask.astype(np.float64)
    total = np.where(mask, moment(inside, 0, 0), 1.0)
    x, y = moment(inside, 1, 0) / total, moment(inside, 0, 1) / total
    xx = moment(inside, 2, 0) / total - x * x
    xy = moment(inside, 1, 1) / total - x * y
    yy = moment(inside, 0, 2) / total - y * y
    least = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    known = mask & (least > _LEAST_SPREAD * across[2].sum())
    determinant = np.where(known, xx * yy - xy * xy, 1.0)
    value, right, up = np.zeros((3, *values.shape))
    for i, image in enumerate(values):
        weighted = np.where(mask, image, 0.0)
        mean = moment(weighted, 0, 0) / total
        with_x = moment(weighted, 1, 0) / total - x * mean
        with_y = moment(weighted, 0, 1) / total - y * mean
        right[i] = (yy * with_x - xy * with_y) / determinant
        up[i] = (xx * with_y - xy * with_x) / determinant
        value[i] = mean - right[i] * x - up[i] * y
    return Planes(value, right, up, known)
