"""Light that an object reflects onto itself, as a part of each image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from rig.arrays import Float32


@dataclass(frozen=True, eq=False)
class ReflectedLight:
    """Light from other parts of the object in N images.

    Parameters
    ----------
    shares
        ``(N, h, w)`` float32, or ``(N, h, w, 3)`` of images in colour: the light in squares of
        pixels, relative to their mean over all images.
    factor
        Pixels along the side of a square.
    mean
        ``(H, W)`` or ``(H, W, 3)`` float32 mean of each pixel over all images.
    """

    shares: Float32
    factor: int
    mean: Float32

    def of(self, index: int, rows: slice = slice(None)) -> Float32:
        """Return the light in rows of an image, interpolated between the squares."""
        mean = self.mean[rows]
        down, across = (
            ((np.arange(size) + 0.5) / self.factor - 0.5).astype(np.float32)
            for size in self.mean.shape[:2]
        )
        x, y = np.meshgrid(across, down[rows])
        found = cv2.remap(
            self.shares[index], x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        return np.asarray(mean * found, np.float32)

    def take(self, indices: Sequence[int]) -> ReflectedLight:
        """Return the light in the images with these indices."""
        return replace(self, shares=self.shares[list(indices)])
