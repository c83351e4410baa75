"""Exact position of the edge of a mirror sphere within a blurred step."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.ndimage import gaussian_filter1d

from calibration._spheres.robust import Array

REACH_PX = 2.5
STEP_PX = 0.25
# Trial blurs: of a sharp lens and a small pixel, up to one that is clearly out of focus.
LARGEST_BLUR_PX = 1.4
_BLURS_PX = (0.35, 0.45, 0.55, 0.65, 0.8, 0.95, 1.15, LARGEST_BLUR_PX)
# Neighbouring profiles are alike: so many show the blur.
_ENOUGH = 200
_LONGEST_SHIFT_PX = 1.0
SHIFT_STEP_PX = 0.05
# Parameters of the model; profiles that are compared at once, few enough for the cache.
_PARAMETERS, _AT_ONCE = 4, 512


def profile_offsets() -> Array:
    """Return the distances from the approximate outline at which `edge_offsets` needs samples."""
    count = round(2 * REACH_PX / STEP_PX) + 1
    offsets: Array = (np.arange(count, dtype=np.float64) - count // 2) * STEP_PX
    return offsets


def edge_offsets(profiles: Array, blur_px: float) -> Array:
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
        ``(M, S)`` linear brightness at `profile_offsets`, from inside to outside.
    blur_px
        Standard deviation of the blur in pixels, one of the values of `estimate_blur`.

    Returns
    -------
    Array
        ``(M,)`` offset of the edge in pixels, positive outwards; within 1 px.
    """
    return _offsets(edge_costs(profiles, blur_px))


def estimate_blur(profiles: Array) -> float:
    """Return the blur of edges: the standard deviation for which the model fits them best.

    Parameters
    ----------
    profiles
        ``(M, S)`` linear brightness at `profile_offsets` of profiles that show an edge; M >= 1.

    Returns
    -------
    float
        0.35 to 1.4 px; it includes the size of a pixel.
    """
    profiles = profiles[:: max(len(profiles) // _ENOUGH, 1)]
    power = np.maximum(profiles.var(axis=1), 1e-300)
    misfits = [np.median(edge_costs(profiles, blur).min(axis=1) / power) for blur in _BLURS_PX]
    return _BLURS_PX[int(np.argmin(misfits))]


def edge_costs(profiles: Array, blur_px: float) -> Array:
    """Return the squared error ``(M, shifts)`` of the model in each profile at each trial shift."""
    bases = _bases(blur_px)
    shifts = bases.shape[1] // _PARAMETERS
    costs: Array = np.zeros((len(profiles), shifts))
    for first in range(0, len(profiles), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        # The model contains constants, which are removed first for accuracy.
        varying = profiles[some] - profiles[some].mean(axis=1, keepdims=True)
        explained = varying @ bases
        explained *= explained
        rest = costs[some]
        rest[:] = np.einsum("ms,ms->m", varying, varying)[:, None]
        for start in range(0, bases.shape[1], shifts):
            rest -= explained[:, start : start + shifts]
    return np.maximum(costs, 0.0, out=costs)


def _offsets(costs: Array) -> Array:
    """Return the shift ``(M,)`` with the least cost in ``(M, shifts)``, interpolated."""
    shifts = trial_shifts()
    best = np.clip(np.argmin(costs, axis=1), 1, len(shifts) - 2)
    row = np.arange(len(costs))
    before, least, after = costs[row, best - 1], costs[row, best], costs[row, best + 1]
    curve = before - 2 * least + after
    part = np.where(curve > 0, 0.5 * (before - after) / np.maximum(curve, 1e-300), 0.0)
    offsets: Array = shifts[best] + SHIFT_STEP_PX * np.clip(part, -1.0, 1.0)
    return offsets


def trial_shifts() -> Array:
    """Return the trial positions of the edge in pixels, those of `edge_costs`."""
    count = round(_LONGEST_SHIFT_PX / SHIFT_STEP_PX)
    shifts: Array = np.arange(-count, count + 1, dtype=np.float64) * SHIFT_STEP_PX
    return shifts


@cache
def _bases(blur_px: float) -> Array:
    """Return orthonormal bases of the model, ``(S, parameters * shifts)``."""
    offsets = profile_offsets()
    fine_step = 0.05
    fine = np.arange(-REACH_PX - 3, REACH_PX + 3 + fine_step / 2, fine_step)
    bases = []
    for shift in trial_shifts():
        depth = shift - fine
        inside = np.clip(depth / fine_step + 0.5, 0.0, 1.0)  # share of each step
        limb = np.sqrt(np.maximum(depth, 0.0))
        shapes = [1 - inside, np.minimum(depth, 0.0), inside, limb]
        blurred = [
            np.interp(offsets, fine, gaussian_filter1d(shape, blur_px / fine_step, mode="nearest"))
            for shape in shapes
        ]
        bases.append(np.linalg.qr(np.stack(blurred, axis=1))[0])
    return np.ascontiguousarray(np.stack(bases, axis=2).reshape(len(offsets), -1))
