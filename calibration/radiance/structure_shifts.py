"""Shifts of images under different lights, to about a pixel, without knowing the lights."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from calibration.radiance.shifted_rows import Shift
from rig.arrays import Float32, Float64

_WIDTH_PX = 1.5
_ROUNDS = 2


def structure_shifts(images: Sequence[Float32]) -> Float64:
    """Return shifts by where fine structure is strong, whatever its sign.

    Strength depends less on the light than structure itself, and has no period of a pattern.

    Parameters
    ----------
    images
        N images ``(H, W)``, linear, NaN where saturated.

    Returns
    -------
    Float64
        ``(N, 2)`` pixels right and down, against the median.

    Examples
    --------
    >>> import numpy as np
    >>> from calibration.radiance import structure_shifts
    >>> paint = np.random.default_rng(1).uniform(0.2, 1, (80, 80)).astype(np.float32)
    >>> images = [paint, 0.5 * np.roll(paint, 4, axis=1), paint]
    >>> structure_shifts(images).round()[1] + 0.0
    array([4., 0.])
    """
    maps = []
    for image in images:
        root = np.sqrt(np.maximum(np.nan_to_num(image, nan=1.0), 0))
        fine = np.abs(root - cv2.GaussianBlur(root, (0, 0), _WIDTH_PX))
        even = cv2.GaussianBlur(fine, (0, 0), _WIDTH_PX) / max(float(fine.mean()), 1e-9)
        maps.append(np.asarray(even, np.float32))
    height, width = maps[0].shape
    window = cv2.createHanningWindow((width, height), cv2.CV_32F)
    shifts, reference = np.zeros((len(maps), 2)), maps[len(maps) // 2]
    for _ in range(_ROUNDS):
        found = [cv2.phaseCorrelate(reference, one, window)[0] for one in maps]
        shifts = np.array(found)
        aligned = [
            Shift(right, down).moved(one, 0, slice(0, height))
            for one, (right, down) in zip(maps, shifts.tolist(), strict=True)
        ]
        reference = np.asarray(np.nan_to_num(aligned).mean(axis=0), np.float32)
    return np.asarray(shifts - np.median(shifts, axis=0))
