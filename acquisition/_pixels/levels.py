"""Samples with different black or white levels, changed so that one level holds for all."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

_ROWS = 256


def level_white(
    pixels: npt.NDArray[np.uint16], whites: npt.NDArray[np.float64]
) -> npt.NDArray[np.uint16]:
    """Raise saturated samples to the highest white level of a block ``(K, K)`` that repeats."""
    white = whites.max()
    if (whites == white).all():
        return pixels
    level = pixels.copy()
    for y, x in np.ndindex(*whites.shape):
        plane = level[y :: whites.shape[0], x :: whites.shape[1]]
        plane[plane >= whites[y, x]] = white
    return level


def level_black(
    pixels: npt.NDArray[np.uint16], levels: npt.NDArray[np.float64], black: float, white: float
) -> npt.NDArray[np.uint16]:
    """Shift samples from their black levels to one; saturated samples stay as they are.

    Parameters
    ----------
    pixels
        ``(H, W)`` samples, DN.
    levels
        Their black levels, DN: ``(H, W)``, or a block that repeats.
    black
        The one black level, DN.
    white
        Samples from this value on are saturated, DN.
    """
    shifts = np.rint(black - levels).astype(np.int32)
    if not shifts.any():
        return pixels
    level = np.empty_like(pixels)
    height, width = levels.shape
    columns = np.arange(pixels.shape[1]) % width
    # In parts, because shifts need more memory than samples.
    for top in range(0, len(pixels), _ROWS):
        rows = pixels[top : top + _ROWS]
        shifted = rows + shifts[np.arange(top, top + len(rows)) % height][:, columns]
        level[top : top + _ROWS] = np.where(rows >= white, rows, np.clip(shifted, 0, 65535))
    return level
