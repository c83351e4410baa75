"""Samples with different black levels, shifted to one."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

_ROWS = 256


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
