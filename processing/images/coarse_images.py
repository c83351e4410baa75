"""Images of an object in averages of blocks, with their view."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from processing.images.block_means import block_mean
from processing.images.recorded_images import Images
from processing.images.viewing_rays import View
from rig.arrays import Bool, Float32, Float64

# Light vectors change slowly: this many pixels, averages of blocks, show the shape well enough.
_PIXELS = 60_000


@dataclass(frozen=True, eq=False)
class CoarseImages:
    """The images in averages of ``factor x factor`` pixels."""

    values: Float32
    mask: Bool
    view: View
    origins: Float64
    rays: Float64
    factor: int

    def points(self, depth: Float64) -> Float64:
        """Return the points at depths along the rays."""
        return np.asarray(self.origins + depth[..., None] * self.rays, np.float64)


def coarse_images(
    values: Images, mask: Bool, view: View, pixels: int | None = None
) -> CoarseImages:
    """Average blocks; a block with a missing sample or a pixel outside the mask is left out.

    About as many blocks as ``pixels``, 60,000 by default, are on the object, or more.
    """
    factor = max(1, math.isqrt(int(np.count_nonzero(mask)) // (pixels or _PIXELS)))
    while True:
        height, width = (size // factor for size in mask.shape)
        blocks = mask[: height * factor, : width * factor].reshape(height, factor, width, factor)
        inside = np.asarray(blocks.all(axis=(1, 3)), np.bool_)
        if factor == 1 or np.count_nonzero(inside) * factor**2 > 0.5 * np.count_nonzero(mask):
            break
        factor -= 1
    small = view.downscaled(factor) if factor > 1 else view
    if factor > 1:
        # Averages of whole blocks; NaN spreads to its block.
        window = slice(height * factor), slice(width * factor)
        averages = np.stack([block_mean(image[window], factor) for image in values])
    else:
        averages = values if isinstance(values, np.ndarray) else values.stack().values
    return CoarseImages(averages, inside, small, *small.rays(), factor)
