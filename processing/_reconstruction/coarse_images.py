"""The images of an object in averages of blocks of pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from processing._reconstruction.recorded_images import Images
from processing._reconstruction.views import View

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# Light vectors change slowly: this many pixels, averages of blocks, show the shape well enough.
_PIXELS = 60_000


@dataclass(frozen=True, eq=False)
class CoarseImages:
    """The images in averages of ``factor x factor`` pixels."""

    values: Float
    mask: Mask
    view: View
    origins: Double
    rays: Double
    factor: int

    def points(self, depth: Double) -> Double:
        return np.asarray(self.origins + depth[..., None] * self.rays, np.float64)


def coarse_images(values: Images, mask: Mask, view: View) -> CoarseImages:
    """Average blocks; a block with a missing sample or a pixel outside the mask is left out."""
    factor = max(1, math.isqrt(int(np.count_nonzero(mask)) // _PIXELS))
    while True:
        height, width = (size // factor for size in mask.shape)
        blocks = mask[: height * factor, : width * factor].reshape(height, factor, width, factor)
        inside = np.asarray(blocks.all(axis=(1, 3)), np.bool_)
        if factor == 1 or np.count_nonzero(inside) * factor**2 > 0.5 * np.count_nonzero(mask):
            break
        factor -= 1
    small = view.downscaled(factor) if factor > 1 else view
    if factor > 1:
        size = (width, height)
        averages = np.zeros((len(values), height, width), np.float32)
        for image, out in zip(values, averages, strict=True):
            part = image[: height * factor, : width * factor]
            # Averages of whole blocks; NaN spreads to its block.
            cv2.resize(part, size, dst=out, interpolation=cv2.INTER_AREA)
    else:
        averages = values if isinstance(values, np.ndarray) else values.stack().values
    return CoarseImages(averages, inside, small, *small.rays(), factor)
