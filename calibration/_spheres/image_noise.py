"""The noise of one image."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

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
