"""Normal maps of a lower resolution, as a sensor with larger pixels makes them."""

from __future__ import annotations

import math

import cv2
import numpy as np

from acquisition import DataError
from processing.maps.normal_map import NormalMap, check_normal_map

# A large pixel of which less than this share is known has no normal.
_LEAST_SHARE = 0.25
_LARGEST_NOISE_DEG = 45.0


def low_resolution(
    normal_map: NormalMap,
    scale: int,
    *,
    blur_px: float = 0.0,
    noise_deg: float = 0.0,
    seed: int = 0,
) -> NormalMap:
    """Return the normal map that a sensor with larger pixels records.

    Each large pixel is the mean of the known normals of ``scale x scale`` pixels, of unit length:
    the light of a pixel is the sum over its area, and is linear in the normal of a matte surface.

    Parameters
    ----------
    normal_map
        The map. Columns and rows at the right and lower side that do not fill a large pixel are
        left out.
    scale
        Side of a large pixel in pixels, 1 or more.
    blur_px
        Standard deviation of the blur of a lens in pixels of the map, 0 or more.
    noise_deg
        Standard deviation of the error of each normal in degrees, both tangent directions together,
        0 to 45.
    seed
        Fixes the noise, 0 to 2^63 - 1.

    Returns
    -------
    NormalMap
        The map of ``height // scale`` x ``width // scale`` pixels; a pixel is known if at least a
        quarter of its area is.

    Raises
    ------
    DataError
        If the map is smaller than a large pixel, no pixel is known, or a number is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap
    >>> from processing.superres import low_resolution
    >>> y, x = np.mgrid[1:-1:64j, -1:1:96j]
    >>> bowl = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]))
    >>> low_resolution(bowl, 4)
    NormalMap(float32[16, 24, 3], 384 normals)
    """
    check_normal_map("normal_map", normal_map)
    _check(normal_map, scale, blur_px, noise_deg, seed)
    height, width = (length // scale for length in normal_map.size)
    weight = normal_map.mask.astype(np.float32)
    sums = normal_map.normals
    if blur_px:
        # The blurred mask, by which each mean would be divided, has no effect on its direction.
        blurred = cv2.GaussianBlur(sums, (0, 0), blur_px)
        sums = np.where(normal_map.mask[..., None], blurred, np.float32(0))
    window = slice(0, height * scale), slice(0, width * scale)
    blocks = (height, scale, width, scale)
    known = weight[window].reshape(blocks).mean(axis=(1, 3)) >= _LEAST_SHARE
    if not known.any():
        raise DataError(
            f"no block of {scale} x {scale} pixels is known by a quarter: the mask is too thin"
        )
    mean = sums[window].reshape(*blocks, 3).mean(axis=(1, 3), dtype=np.float64)
    made = NormalMap.from_vectors(mean, known)
    return _noisy(made, noise_deg, seed) if noise_deg else made


def _check(normal_map: NormalMap, scale: int, blur_px: float, noise_deg: float, seed: int) -> None:
    height, width = normal_map.size
    if scale != int(scale) or not 1 <= scale <= min(height, width):
        raise DataError(
            f"a scale of {scale} is out of range for a normal map of {width} x {height} pixels: "
            f"use a whole number from 1 to {min(height, width)}"
        )
    if not (math.isfinite(blur_px) and 0 <= blur_px <= min(height, width)):
        raise DataError(
            f"a blur of {blur_px} pixels is out of range: use 0 to {min(height, width)}"
        )
    if not 0 <= noise_deg <= _LARGEST_NOISE_DEG:
        raise DataError(
            f"a noise of {noise_deg} degrees is out of range: use 0 to {_LARGEST_NOISE_DEG:g}"
        )
    if not 0 <= seed < 2**63:
        raise DataError(f"a seed of {seed} is out of range: use 0 to 2^63 - 1")


def _noisy(normal_map: NormalMap, noise_deg: float, seed: int) -> NormalMap:
    """Turn each normal by a random angle, as equal errors of both tangent directions do."""
    noise = np.random.default_rng(seed).normal(size=normal_map.normals.shape)
    normals = normal_map.normals.astype(np.float64)
    across = noise - (noise * normals).sum(axis=2, keepdims=True) * normals
    turned = normals + math.radians(noise_deg) / math.sqrt(2) * across
    return NormalMap.from_vectors(turned, normal_map.mask)
