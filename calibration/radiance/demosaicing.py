"""Demosaicing of Bayer images."""

from __future__ import annotations

import cv2
import numpy as np

from acquisition import DataError
from rig.arrays import Float32, Float64

_PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
_RED_BLUE = np.array([[0.25, 0.5, 0.25], [0.5, 1, 0.5], [0.25, 0.5, 0.25]], np.float32)
_GREEN = np.array([[0, 0.25, 0], [0.25, 1, 0.25], [0, 0.25, 0]], np.float32)
# ITU-R BT.601 luma, as in the published results on DiLiGenT.
LUMA = np.array([0.2989, 0.587, 0.114], np.float32)


def demosaic(mosaic: Float32, pattern: str) -> Float32:
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

    Examples
    --------
    >>> import numpy as np
    >>> from calibration.radiance import demosaic
    >>> card = np.tile(np.array([[1, 2], [2, 3]], np.float32), (2, 2))
    >>> demosaic(card, "RGGB")[1, 1]
    array([1., 2., 3.], dtype=float32)
    """
    check_pattern(pattern)
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


def site_factors(pattern: str, first: tuple[int, int], factor: int) -> Float64:
    """Return by how much `demosaic` and averaging change the variance of equally noisy samples.

    Parameters
    ----------
    pattern
        As in `demosaic`.
    first
        Row and column of the first pixel of the result in the mosaic.
    factor
        Rows and columns that are averaged.

    Returns
    -------
    NDArray
        ``(2, 2, 3)`` factor of each colour at the pixels of the result, which repeat.
    """
    margin = 2
    factors = np.zeros((2, 2, 3))
    for row in range(2):
        for column in range(2):
            # The mosaic from `margin` before the block on, and the weight of its samples.
            weight = np.zeros((factor + 2 * margin, factor + 2 * margin))
            weight[margin:-margin, margin:-margin] = 1 / factor**2
            top, left = first[0] + row * factor - margin, first[1] + column * factor - margin
            rows, columns = np.indices(weight.shape)
            site = 2 * ((rows + top) % 2) + (columns + left) % 2
            for channel, name in enumerate("RGB"):
                kernel = _GREEN if name == "G" else _RED_BLUE
                spread = cv2.filter2D(weight, -1, kernel, borderType=cv2.BORDER_CONSTANT)
                of_colour = np.isin(site, [i for i in range(4) if pattern[i] == name])
                factors[row, column, channel] = np.sum((spread * of_colour) ** 2)
    return factors


def check_pattern(pattern: str) -> None:
    """Raise `DataError` if a colour filter pattern is not supported."""
    if pattern not in _PATTERNS:
        raise DataError(
            f"the colour filter pattern {pattern} is not supported: use {', '.join(_PATTERNS)}"
        )


def luma(colour: Float32) -> Float32:
    """Return the gray values ``0.2989 R + 0.587 G + 0.114 B`` of linear colours ``(..., 3)``.

    Examples
    --------
    >>> import numpy as np
    >>> from calibration.radiance import luma
    >>> luma(np.array([[1, 0, 0], [1, 1, 1]], np.float32)).round(4)
    array([0.2989, 0.9999], dtype=float32)
    """
    return np.asarray(colour @ LUMA, np.float32)
