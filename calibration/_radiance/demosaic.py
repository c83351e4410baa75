"""Demosaicing of Bayer images."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from acquisition import DataError

_PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
_RED_BLUE = np.array([[0.25, 0.5, 0.25], [0.5, 1, 0.5], [0.25, 0.5, 0.25]], np.float32)
_GREEN = np.array([[0, 0.25, 0], [0.25, 1, 0.25], [0, 0.25, 0]], np.float32)


def demosaic(mosaic: npt.NDArray[np.float32], pattern: str) -> npt.NDArray[np.float32]:
    """Interpolate a Bayer mosaic bilinearly.

    Saturated samples (NaN) are left out of the interpolation. A pixel is NaN in a colour if its
    own sample of this colour, or all neighbouring samples of this colour, are saturated.

    Parameters
    ----------
    mosaic
        ``(H, W)`` linear image, NaN where saturated.
    pattern
        The colours of the first 2 x 2 pixels, row by row: RGGB, BGGR, GRBG or GBRG.

    Returns
    -------
    NDArray
        ``(H, W, 3)`` RGB.

    Raises
    ------
    DataError
        If the pattern is not supported.
    """
    if pattern not in _PATTERNS:
        raise DataError(
            f"the colour filter pattern {pattern} is not supported: use {', '.join(_PATTERNS)}"
        )
    valid = np.isfinite(mosaic)
    filled = np.where(valid, mosaic, np.float32(0))
    colour = np.zeros((*mosaic.shape, 3), np.float32)
    for channel, name in enumerate("RGB"):
        place = np.zeros(mosaic.shape, bool)
        for site in range(4):
            if pattern[site] == name:
                place[site // 2 :: 2, site % 2 :: 2] = True
        kernel = _GREEN if name == "G" else _RED_BLUE
        counted = (place & valid).astype(np.float32)
        weight = cv2.filter2D(counted, -1, kernel, borderType=cv2.BORDER_CONSTANT)
        total = cv2.filter2D(filled * counted, -1, kernel, borderType=cv2.BORDER_CONSTANT)
        # The kernel at a site of a colour contains no other site of that colour.
        interpolated = weight > 0
        colour[..., channel] = np.where(
            interpolated, total / np.where(interpolated, weight, 1), np.nan
        )
    return colour
