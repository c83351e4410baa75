"""Exact position of the edge of a mirror sphere within a blurred step."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import cv2
import numpy as np

from calibration.spheres.geometry.ellipse import Ellipse
from rig.arrays import Float32, Float64, Floating, Intp

REACH_PX = 2.5
STEP_PX = 0.25
# Trial blurs: of a sharp lens and a small pixel, up to one that is clearly out of focus.
LARGEST_BLUR_PX = 1.4
_BLURS_PX = (0.35, 0.45, 0.55, 0.65, 0.8, 0.95, 1.15, LARGEST_BLUR_PX)
# Neighbouring profiles are alike: so many show the blur.
_ENOUGH = 200
_LONGEST_SHIFT_PX = 1.0
SHIFT_STEP_PX = 0.05
# Parameters of the model. Profiles that are compared at once, few enough for the cache, and those
# of one product: OpenBLAS computes larger ones in several threads, which cost more than they save.
_PARAMETERS, _AT_ONCE, _OF_PRODUCT = 4, 2048, 64
_LEAST_POWER = 1e-30
Profiles = Floating
"""Samples ``(S, ...)`` across an outline, from inside to outside; the last axis is the angle."""


def profile_offsets() -> Float64:
    """Return the distances from the approximate outline at which `edge_offsets` needs samples."""
    count = round(2 * REACH_PX / STEP_PX) + 1
    return (np.arange(count, dtype=np.float64) - count // 2) * STEP_PX


def edge_offsets(profiles: Profiles, blur_px: float) -> Float64:
    """Locate the edge in radial profiles across the outline of a mirror sphere.

    Just inside its edge, a mirror sphere shows its immediate surroundings, and farther inside it
    shows more distant parts of the scene: at the depth d inside the edge, the reflected ray is
    rotated by ``2 sqrt(2 d / r)``, so the brightness is ``a + b sqrt(d)`` for small d. The steepest
    point and the half level of this limb are about 0.15 px outside the true edge. The model is the
    limb inside and a straight line outside, both blurred by the lens and the pixel; the edge is the
    position with the least squared error. A blur that is wrong by 0.3 px moves the edge by 0.05 to
    0.15 px, so `estimate_blur` measures it.

    Parameters
    ----------
    profiles
        ``(S, M)`` linear brightness at `profile_offsets`, from inside to outside.
    blur_px
        Standard deviation of the blur in pixels, one of the values of `estimate_blur`.

    Returns
    -------
    Array
        ``(M,)`` offset of the edge in pixels, positive outwards; within 1 px.
    """
    costs = edge_costs(profiles, blur_px)
    return interpolated_shifts(costs, np.argmin(costs, axis=0))


def estimate_blur(profiles: Profiles) -> float:
    """Return the blur of edges: the standard deviation for which the model fits them best.

    Parameters
    ----------
    profiles
        ``(S, M)`` linear brightness at `profile_offsets` of profiles that show an edge; M >= 1.

    Returns
    -------
    float
        0.35 to 1.4 px; it includes the size of a pixel.
    """
    profiles = profiles[:, :: max(profiles.shape[1] // _ENOUGH, 1)]
    power = np.maximum(profiles.var(axis=0), _LEAST_POWER)
    misfits = [np.median(edge_costs(profiles, blur).min(axis=0) / power) for blur in _BLURS_PX]
    return _BLURS_PX[int(np.argmin(misfits))]


def edge_costs(profiles: Profiles, blur_px: float) -> Profiles:
    """Return the squared error ``(shifts, M)`` of the model at each trial shift in each profile.

    They have the precision of the profiles.
    """
    bases = _bases(blur_px, profiles.dtype)
    shifts = len(bases) // _PARAMETERS
    # The model contains constants, which are removed first for accuracy.
    varying = profiles - profiles.mean(axis=0)
    costs = np.zeros((shifts, profiles.shape[1]), profiles.dtype)
    explained = np.zeros((len(bases), min(_AT_ONCE, profiles.shape[1])), profiles.dtype)
    for first in range(0, profiles.shape[1], _AT_ONCE):
        rest, some = (of[:, first : first + _AT_ONCE] for of in (costs, varying))
        part = explained[:, : some.shape[1]]
        for start in range(0, some.shape[1], _OF_PRODUCT):
            columns = slice(start, start + _OF_PRODUCT)
            np.matmul(bases, some[:, columns], out=part[:, columns])
        part *= part
        np.subtract(np.square(some).sum(axis=0), part[:shifts], out=rest)
        for parameter in range(shifts, len(bases), shifts):
            rest -= part[parameter : parameter + shifts]
    return np.maximum(costs, 0.0, out=costs)


def interpolated_shifts(costs: Profiles, best: Intp) -> Float64:
    """Return the shifts with the least cost in ``(shifts, M)``, next to the trial shifts given."""
    shifts = trial_shifts()
    middle, column = np.clip(best, 1, len(shifts) - 2), np.arange(len(best))
    before, least, after = (costs[middle + step, column].astype(np.float64) for step in (-1, 0, 1))
    curve = before - 2 * least + after
    part = np.where(curve > 0, 0.5 * (before - after) / np.maximum(curve, 1e-300), 0.0)
    return shifts[middle] + SHIFT_STEP_PX * np.clip(part, -1.0, 1.0)


def trial_shifts() -> Float64:
    """Return the trial positions of the edge in pixels, those of `edge_costs`."""
    count = round(_LONGEST_SHIFT_PX / SHIFT_STEP_PX)
    return np.arange(-count, count + 1, dtype=np.float64) * SHIFT_STEP_PX


@cache
def _bases(blur_px: float, dtype: np.dtype[np.floating]) -> Profiles:
    """Return orthonormal bases of the model, ``(parameters * shifts, S)``."""
    offsets = profile_offsets()
    fine_step = 0.05
    fine = np.arange(-REACH_PX - 3, REACH_PX + 3 + fine_step / 2, fine_step)
    kernel = gaussian(blur_px / fine_step)
    bases = []
    for shift in trial_shifts():
        depth = shift - fine
        inside = np.clip(depth / fine_step + 0.5, 0.0, 1.0)  # share of each step
        limb = np.sqrt(np.maximum(depth, 0.0))
        shapes = [1 - inside, np.minimum(depth, 0.0), inside, limb]
        longer = [np.pad(shape, len(kernel) // 2, mode="edge") for shape in shapes]
        blurred = [np.interp(offsets, fine, np.convolve(of, kernel, "valid")) for of in longer]
        bases.append(np.linalg.qr(np.stack(blurred, axis=1))[0])
    by_parameter = np.stack(bases).transpose(2, 0, 1).reshape(-1, len(offsets))
    return np.ascontiguousarray(by_parameter, dtype)


def stack_profiles(
    images: Sequence[Float32], ellipse: Ellipse, angles: Float64, offsets: Float64
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


def gaussian(sigma: float) -> Float64:
    """Return the weights of a Gaussian filter, to four standard deviations."""
    reach = int(4 * sigma + 0.5)
    weights: Float64 = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    weights /= weights.sum()
    return weights
