"""Pixels with a high dark current."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from acquisition import row_bands

# Share of the range from black to white above which a pixel is hot, and standard deviations of the
# dark frame above its surroundings.
_EXCESS = 0.01
_DEVIATIONS = 8.0
_ROWS = 200
# Pixels around one, to each side, of which the median is taken.
_AROUND = 2


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
    # Every excess is above the darkest pixel.
    if min(dark.shape[:2]) < 5 or not dark.max() - dark.min() > _EXCESS:
        return np.zeros(dark.shape, np.bool_)
    excess = np.zeros_like(dark)
    for band in row_bands(len(dark)):  # the median of the whole would be one more image in memory
        first = max(band.start - _AROUND, 0)
        around = np.ascontiguousarray(dark[first : band.stop + _AROUND], np.float32)
        median = cv2.medianBlur(around, 2 * _AROUND + 1)
        excess[band] = dark[band] - median[band.start - first :][: band.stop - band.start]
    # Some of the rows show the spread of all.
    rows = excess[:: max(1, len(excess) // _ROWS)]
    spread = 1.4826 * float(np.median(np.abs(rows)))
    hot: npt.NDArray[np.bool_] = excess > max(_EXCESS, _DEVIATIONS * spread)
    return hot
