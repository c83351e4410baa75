"""The small rotation between normals of the same points."""

from __future__ import annotations

from typing import Final

import numpy as np

from rig.arrays import Float64

# Normals that differ by more than this many times the median count less.
_OUTLIER: Final = 4.0
# Neighbouring normals are not independent: noise is common to about this many pixels.
COMMON_PX: Final = 16


def rotation_between(a: Float64, b: Float64) -> tuple[Float64, Float64]:
    """Return the small rotation vector ``(3,)`` from unit vectors ``(P, 3)`` to others.

    The covariance ``(3, 3)`` follows, both in radians.
    """
    difference = b - a
    distance = np.linalg.norm(difference, axis=1)
    weights = 1 / (1 + (distance / (_OUTLIER * np.median(distance) + 1e-9)) ** 2)
    # b - a = tilt x a = -[a]x tilt
    x, y, z = a.T
    zero = np.zeros_like(x)
    cross = np.stack(
        [np.stack([zero, z, -y]), np.stack([-z, zero, x]), np.stack([y, -x, zero])]
    ).transpose(2, 0, 1)
    normal = np.einsum("pij,p,pik->jk", cross, weights, cross)
    # What the normals do not determine stays 0: a turn about the only direction of a plane.
    normal += 1e-4 * np.trace(normal) * np.eye(3)
    tilt = np.linalg.solve(normal, np.einsum("pij,p,pi->j", cross, weights, difference))
    left = difference - np.einsum("pij,j->pi", cross, tilt)
    variance = float((weights[:, None] * left**2).sum() / (2 * weights.sum()))
    return tilt, np.linalg.inv(normal) * variance * COMMON_PX
