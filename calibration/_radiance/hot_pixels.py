"""Pixels with a high dark current."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

# Share of the range from black to white above which a pixel is hot, and standard deviations of the
# dark frame above its surroundings.
_EXCESS = 0.01
_DEVIATIONS = 8.0


def hot_pixels(dark: npt.NDArray[np.float32]) -> npt.NDArray[np.bool_]:
    """Return the hot pixels of a dark frame.

    A pixel is hot if it is brighter than the median of the 5 x 5 pixels around it by more than 1 %
    of the range and 8 standard deviations of the frame.

    Parameters
    ----------
    dark
        ``(H, W)`` or ``(H, W, 3)`` signal without light, 1 at white.

    Returns
    -------
    NDArray
        bool of the same shape.
    """
    if min(dark.shape[:2]) < 5:
        return np.zeros(dark.shape, np.bool_)
    excess = dark - cv2.medianBlur(np.ascontiguousarray(dark, np.float32), 5)
    spread = 1.4826 * float(np.median(np.abs(excess)))
    hot: npt.NDArray[np.bool_] = excess > max(_EXCESS, _DEVIATIONS * spread)
    return hot
