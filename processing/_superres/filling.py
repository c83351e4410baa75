"""Vectors continued from a mask outwards, so that no background enters an interpolation."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

_LEAST_LENGTH = 1e-6
_FACING = np.array([0, 0, 1], np.float32)


def filled_outwards(vectors: Float, mask: Mask, rings: int) -> Float:
    """Continue unit vectors beyond their mask, ring by ring.

    Each ring consists of the neighbours of the known pixels and takes the mean direction of those
    among its eight neighbours. A mirrored or turned map gives the mirrored or turned result.

    Parameters
    ----------
    vectors
        ``(H, W, 3)`` float32, unit vectors inside the mask and 0 outside.
    mask
        ``(H, W)`` bool.
    rings
        How many pixels far to continue; beyond, the result is (0, 0, 1).

    Returns
    -------
    Float
        ``(H, W, 3)`` float32 unit vectors.
    """
    filled, known = vectors.copy(), mask.copy()
    for _ in range(rings):
        if known.all():
            break
        sums = cv2.boxFilter(filled, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
        near = cv2.dilate(known.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        ring = near & ~known
        sums = sums[ring]
        length = np.linalg.norm(sums, axis=1, keepdims=True)
        means = sums / np.maximum(length, _LEAST_LENGTH)
        # Opposite neighbours cancel out; such a pixel faces the camera.
        filled[ring] = np.where(length > _LEAST_LENGTH, means, _FACING)
        known |= ring
    filled[~known] = (0, 0, 1)
    return filled
