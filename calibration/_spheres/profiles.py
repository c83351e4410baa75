"""Images across an outline: samples along radii, and Gaussian filters of them."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from calibration._spheres.ellipse import Ellipse
from calibration._spheres.robust import Array

Profiles = npt.NDArray[np.floating]
"""Samples ``(S, ...)`` across an outline, from inside to outside; the last axis is the angle."""


def stack_profiles(
    images: Sequence[npt.NDArray[np.float32]], ellipse: Ellipse, angles: Array, offsets: Array
) -> Profiles:
    """Return images sampled along radii, ``(offsets, images, angles)``."""
    scale = (1 + offsets / ellipse.radius_px).astype(np.float32)[:, None]
    outward = (ellipse.point(angles) - ellipse.centre_px).T.astype(np.float32)
    x, y = (scale * outward[k] + np.float32(ellipse.centre_px[k]) for k in (0, 1))
    sampled = np.zeros((len(offsets), len(images), len(angles)), np.float32)
    for k, image in enumerate(images):
        part = sampled[:, k]
        cv2.remap(image, x, y, cv2.INTER_LINEAR, dst=part, borderMode=cv2.BORDER_REPLICATE)
    return sampled


def smooth_along(profiles: Profiles, sigma: float) -> Profiles:
    """Return profiles that are smoothed along the outline, which is closed."""
    kernel = gaussian(sigma)
    reach = len(kernel) // 2
    rows = profiles.reshape(-1, profiles.shape[-1])
    closed = cv2.copyMakeBorder(rows, 0, 0, reach, reach, cv2.BORDER_WRAP)
    smooth = cv2.sepFilter2D(closed, -1, kernel, np.ones(1))[:, reach:-reach]
    return np.ascontiguousarray(smooth, profiles.dtype).reshape(profiles.shape)


def slopes_across(profiles: Profiles, sigma: float) -> Profiles:
    """Return the slopes of profiles ``(S, M)`` from sample to sample, smoothed."""
    kernel = gaussian(sigma)
    reach = len(kernel) // 2
    kernel *= np.arange(-reach, reach + 1) / sigma**2
    slopes = cv2.sepFilter2D(profiles, -1, np.ones(1), kernel, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(slopes, np.float32)


def gaussian(sigma: float) -> Array:
    """Return the weights of a Gaussian filter, to four standard deviations."""
    reach = int(4 * sigma + 0.5)
    weights: Array = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    weights /= weights.sum()
    return weights
