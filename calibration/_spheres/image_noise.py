"""The noise of images, and the blocks of JPEG compression."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from calibration._radiance.raw_stack import Images

# So many pixels show the noise of an image.
_SHOW_NOISE = 40_000


def image_noise(image: npt.NDArray[np.float32]) -> float:
    """Return the standard deviation of the noise of one image, fine texture included.

    Immerkaer's kernel is insensitive to brightness, slopes and straight edges (Fast noise variance
    estimation, 1996); the upper quartile of its response is that of noise if most of the image is
    even.
    """
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    residue = cv2.filter2D(image, -1, kernel)
    every = max(int(np.sqrt(residue.size / _SHOW_NOISE)), 1)
    return float(np.percentile(np.abs(residue[::every, ::every]), 75)) / 6.9


_BLOCK, _FEW_IMAGES, _MIDDLE_PX, _EVERY = 8, 4, 1024, 5
# In the 12 images of the University of Washington's chrome ball: 1.0 without compression, 1.4 with
# quality 95, 1.7 with 90, 2.2 with 85, 3.5 with 75, 5.3 with 60; without colour 1.6 with 85, 1.8
# with 75, 2.3 with 60.
_VISIBLE = 1.7


def shows_blocks(values: Images) -> bool:
    """Return whether images show the borders of blocks of 8 x 8 px, as JPEG compression does.

    Second differences along rows and columns are larger by a factor of 1.7 or more at every eighth
    border between pixels than elsewhere, in both directions. Such borders look like edges.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, NaN where saturated.
    """
    sums = np.zeros((2, _BLOCK))
    if min(values.shape[1:]) < 4 * _BLOCK:
        return False
    height, width = values.shape[1:]
    rows, columns = (
        slice(max(size - _MIDDLE_PX, 0) // 2, (size + _MIDDLE_PX) // 2) for size in (height, width)
    )
    for k in range(0, len(values), -(-len(values) // _FEW_IMAGES)):
        # Square roots, because the steps of quantization are larger where it is bright.
        image = np.sqrt(np.clip(np.nan_to_num(values[k, rows, columns], nan=1.0), 0, 1))
        for along, lines in zip(sums, (image[:, ::_EVERY].T, image[::_EVERY]), strict=True):
            differences = np.abs(np.diff(lines, 2, axis=1)).mean(axis=0, dtype=np.float64)
            along += [differences[first::_BLOCK].mean() for first in range(_BLOCK)]
    # Both differences that contain the border are large.
    pairs = np.minimum(sums, np.roll(sums, 1, axis=1)).max(axis=1)
    return bool(np.all(pairs > _VISIBLE * np.median(sums, axis=1)) and np.all(pairs > 0))
