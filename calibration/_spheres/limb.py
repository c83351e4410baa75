"""Exact position of the edge of a mirror sphere within a blurred step."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.ndimage import gaussian_filter1d

from calibration._spheres.robust import Array

REACH_PX = 2.5
STEP_PX = 0.25
_BLUR_PX = 0.45
_LONGEST_SHIFT_PX = 1.0
_SHIFT_STEP_PX = 0.05


def profile_offsets() -> Array:
    """Return the distances from the approximate outline at which `edge_offsets` needs samples."""
    count = round(2 * REACH_PX / STEP_PX) + 1
    offsets: Array = (np.arange(count, dtype=np.float64) - count // 2) * STEP_PX
    return offsets


def edge_offsets(profiles: Array) -> Array:
    """Locate the edge in radial profiles across the outline of a mirror sphere.

    Just inside its edge, a mirror sphere shows its immediate surroundings, and farther inside it
    shows more distant parts of the scene: at the depth d inside the edge, the reflected ray is
    rotated by ``2 sqrt(2 d / r)``, so the brightness is ``a + b sqrt(d)`` for small d. The steepest
    point and the half level of this limb are about 0.15 px outside the true edge. The model is the
    limb inside and a straight line outside, both blurred by a pixel; the edge is the position with
    the least squared error.

    Parameters
    ----------
    profiles
        ``(M, S)`` linear brightness at `profile_offsets`, from inside to outside.

    Returns
    -------
    Array
        ``(M,)`` offset of the edge in pixels, positive outwards; within 1 px.
    """
    return offsets_of(edge_costs(profiles))


def edge_costs(profiles: Array) -> Array:
    """Return the squared error ``(M, shifts)`` of the model in each profile at each trial shift."""
    _, complements = _complements()
    return np.stack(
        [np.sum((profiles @ complement) ** 2, axis=1) for complement in complements], axis=1
    )


def offsets_of(costs: Array) -> Array:
    """Return the shift ``(M,)`` with the least cost in ``(M, shifts)``, interpolated."""
    shifts, _ = _complements()
    best = np.clip(np.argmin(costs, axis=1), 1, len(shifts) - 2)
    row = np.arange(len(costs))
    before, least, after = costs[row, best - 1], costs[row, best], costs[row, best + 1]
    curve = before - 2 * least + after
    part = np.where(curve > 0, 0.5 * (before - after) / np.maximum(curve, 1e-300), 0.0)
    offsets: Array = shifts[best] + _SHIFT_STEP_PX * np.clip(part, -1.0, 1.0)
    return offsets


@cache
def _complements() -> tuple[Array, Array]:
    """Return trial shifts and, for each, the projection to the complement of the model."""
    offsets = profile_offsets()
    count = round(_LONGEST_SHIFT_PX / _SHIFT_STEP_PX)
    shifts = np.arange(-count, count + 1, dtype=np.float64) * _SHIFT_STEP_PX
    fine_step = 0.05
    fine = np.arange(-REACH_PX - 3, REACH_PX + 3 + fine_step / 2, fine_step)
    complements = []
    for shift in shifts:
        depth = shift - fine
        inside = depth > 0
        shapes = [
            np.where(inside, 0.0, 1.0),
            np.where(inside, 0.0, depth),
            np.where(inside, 1.0, 0.0),
            np.sqrt(np.where(inside, depth, 0.0)),
        ]
        blurred = [
            np.interp(offsets, fine, gaussian_filter1d(shape, _BLUR_PX / fine_step, mode="nearest"))
            for shape in shapes
        ]
        basis = np.linalg.qr(np.stack(blurred, axis=1))[0]
        complements.append(np.eye(len(offsets)) - basis @ basis.T)
    return shifts, np.stack(complements)
