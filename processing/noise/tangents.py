"""Changes of scaled normals, and the parts of them that turn the normals, compiled."""

from __future__ import annotations

import math

import numba

from processing.stereo.pixel_algebra import IN_PLACE
from rig.arrays import Float64

# Compiled in: processing/stereo/pixel_algebra.py f495374b06dc

# Below the square of this tangent, two terms of the series of the squared angle suffice.
_SMALL2 = 1e-6


@numba.njit(**IN_PLACE, error_model="numpy")
def tangent_part(inverse: Float64, m: Float64, length2: float) -> float:
    """Return the trace of a symmetric matrix A (6 numbers) across a vector of known length."""
    along = inverse[0] * m[0] * m[0] + inverse[3] * m[1] * m[1] + inverse[5] * m[2] * m[2]
    along += 2 * (inverse[1] * m[0] * m[1] + inverse[2] * m[0] * m[2] + inverse[4] * m[1] * m[2])
    return float(max(inverse[0] + inverse[3] + inverse[5] - along / length2, 0.0))


@numba.njit(**IN_PLACE, error_model="numpy")
def tangent_trace(inverse: Float64, m: Float64, inner: Float64) -> float:
    """Return ``tr(P A B A P)`` for a symmetric B (6 numbers); A is an inverse."""
    length = math.sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2])
    n0, n1, n2 = m[0] / length, m[1] / length, m[2] / length
    # Rows of A, made tangent: each column loses its part along the normal.
    total = 0.0
    rows = (
        (inverse[0], inverse[1], inverse[2]),
        (inverse[1], inverse[3], inverse[4]),
        (inverse[2], inverse[4], inverse[5]),
    )
    along0 = n0 * inverse[0] + n1 * inverse[1] + n2 * inverse[2]
    along1 = n0 * inverse[1] + n1 * inverse[3] + n2 * inverse[4]
    along2 = n0 * inverse[2] + n1 * inverse[4] + n2 * inverse[5]
    for i in range(3):
        n = n0 if i == 0 else (n1 if i == 1 else n2)
        x, y, z = rows[i][0] - n * along0, rows[i][1] - n * along1, rows[i][2] - n * along2
        total += inner[0] * x * x + inner[3] * y * y + inner[5] * z * z
        total += 2 * (inner[1] * x * y + inner[2] * x * z + inner[4] * y * z)
    return max(total, 0.0)


@numba.njit(**IN_PLACE, error_model="numpy")
def tangent_change(inverse: Float64, m: Float64, b0: float, b1: float, b2: float) -> float:
    """Return the squared tangent part of ``A b``."""
    x = inverse[0] * b0 + inverse[1] * b1 + inverse[2] * b2
    y = inverse[1] * b0 + inverse[3] * b1 + inverse[4] * b2
    z = inverse[2] * b0 + inverse[4] * b1 + inverse[5] * b2
    along = x * m[0] + y * m[1] + z * m[2]
    length2 = m[0] * m[0] + m[1] * m[1] + m[2] * m[2]
    return float(max(x * x + y * y + z * z - along * along / length2, 0.0))


@numba.njit(**IN_PLACE, error_model="numpy")
def squared_angle(m: Float64, start: Float64, length2: float) -> float:
    """Return the squared angle between two vectors, the first of which has a known length."""
    x = m[1] * start[2] - m[2] * start[1]
    y = m[2] * start[0] - m[0] * start[2]
    z = m[0] * start[1] - m[1] * start[0]
    along = m[0] * start[0] + m[1] * start[1] + m[2] * start[2]
    across2 = x * x + y * y + z * z
    if along > 0 and across2 < _SMALL2 * along * along:
        tangent2 = across2 / (along * along)
        return float(tangent2 * (1 - 2 / 3 * tangent2))
    return math.atan2(math.sqrt(across2), along) ** 2
