"""Angles between vectors."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from rig.arrays import Float64

_BLOCK = 1 << 14  # vectors, whose intermediate values stay in the cache


def angle_deg(a: npt.ArrayLike, b: npt.ArrayLike) -> Float64:
    """Return the angle between vectors in degrees, accurate for small angles too.

    Parameters
    ----------
    a, b
        ``(..., 3)`` vectors of any length, which are broadcast against each other.

    Returns
    -------
    Double
        ``(...)`` float64 in 0..180, by ``atan2(|a x b|, a . b)``; 0 if a vector is zero.

    Examples
    --------
    >>> from acquisition import angle_deg
    >>> angle_deg([[0, 0, 1], [0, 2, 2]], [0, 0, 1])
    array([ 0., 45.])
    """
    first, second = np.asarray(a), np.asarray(b)
    shape = np.broadcast_shapes(first.shape, second.shape)[:-1]
    first, second = (
        np.broadcast_to(vectors, (*shape, 3)).reshape(-1, 3) for vectors in (first, second)
    )
    angles = np.zeros(len(first))
    for begin in range(0, len(first), _BLOCK):
        block = slice(begin, begin + _BLOCK)
        angles[block] = _angles(first[block].astype(np.float64), second[block].astype(np.float64))
    result: Float64 = angles.reshape(shape)[()]
    return result


def _angles(first: Float64, second: Float64) -> Float64:
    ax, ay, az = first[..., 0], first[..., 1], first[..., 2]
    bx, by, bz = second[..., 0], second[..., 1], second[..., 2]
    cross = np.sqrt((ay * bz - az * by) ** 2 + (az * bx - ax * bz) ** 2 + (ax * by - ay * bx) ** 2)
    angle: Float64 = np.degrees(np.arctan2(cross, ax * bx + ay * by + az * bz))
    return angle
