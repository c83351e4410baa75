"""Compiled geometry of a warped patch: where its pixels are in the exemplar, and their values."""

from __future__ import annotations

import math

import numba
import numpy as np

from rig.arrays import Float32
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

# More samples per axis of a footprint do not change its mean visibly.
_MOST_SAMPLES = 8
# The largest factor on slopes that makes a mean over footprints as steep as the exemplar.
_MOST_GAIN = 1.5
_ROUNDS = 3


@numba.njit(**PART)
def _summed(steps: Float32, out: Float32, down_first: bool) -> None:
    """Add half of the sums of steps from the centre of a patch, along one axis, then the other."""
    size, middle = steps.shape[0], steps.shape[0] // 2
    here = np.zeros((size, size, 2), np.float32)
    for phase in range(2):
        down = (phase == 0) == down_first
        for sign in (-1, 1):
            for i in range(1, size):
                t = middle + sign * i
                if not 0 <= t < size:
                    break
                first, last = (middle, middle + 1) if phase == 0 else (0, size)
                for j in range(first, last):
                    r, c = (t, j) if down else (j, t)
                    y, x = (t - sign, j) if down else (j, t - sign)
                    axis = 0 if down else 1
                    for k in range(2):
                        mean = (steps[r, c, k, axis] + steps[y, x, k, axis]) / 2
                        here[r, c, k] = here[y, x, k] + sign * mean
    for r in range(size):
        for c in range(size):
            for k in range(2):
                out[r, c, k] += here[r, c, k] / 2


@numba.njit(**PART)
def patch_map(steps: Float32, turn: Float32) -> tuple[Float32, Float32, Float32]:
    """Return the map of a patch.

    Parameters
    ----------
    steps, turn
        ``(n, n, 2, 2)`` and ``(n, n)``: the field on the patch, see `PatternField`.

    Returns
    -------
    offsets
        ``(n, n, 2)``: (down, right) in the exemplar from the centre of the patch.
    jacobian
        ``(n, n, 2, 2)``: derivatives of the offsets.
    turned
        ``(n, n)``: angle in rad by which vectors of the exemplar turn, counter-clockwise.
    """
    size, middle = steps.shape[0], steps.shape[0] // 2
    field = np.zeros((size, size, 2, 2), np.float32)
    angle = np.zeros((size, size), np.float32)
    for r in range(size):
        for c in range(size):
            # Opposite directions are the same grain.
            opposite = math.cos(turn[r, c] - turn[middle, middle]) < 0
            angle[r, c] = turn[r, c] + math.pi if opposite else turn[r, c]
            for k in range(2):
                for m in range(2):
                    field[r, c, k, m] = -steps[r, c, k, m] if opposite else steps[r, c, k, m]
    offsets = np.zeros((size, size, 2), np.float32)
    # Not constants, for each of which it would be compiled.
    for down_first in (True, False):
        _summed(field, offsets, down_first)
    jacobian = np.zeros((size, size, 2, 2), np.float32)
    for r in range(size):
        for c in range(size):
            above, below = max(r - 1, 0), min(r + 1, size - 1)
            left, right = max(c - 1, 0), min(c + 1, size - 1)
            for k in range(2):
                rise = offsets[below, c, k] - offsets[above, c, k]
                jacobian[r, c, k, 0] = rise / (below - above)
                rise = offsets[r, right, k] - offsets[r, left, k]
                jacobian[r, c, k, 1] = rise / (right - left)
            # The rotation part of jacobian field^-1, in (down, right); the determinant of the
            # field is positive.
            a, b = field[r, c, 0, 0], field[r, c, 0, 1]
            d, e = field[r, c, 1, 0], field[r, c, 1, 1]
            g, h = jacobian[r, c, 0, 0], jacobian[r, c, 0, 1]
            i, j = jacobian[r, c, 1, 0], jacobian[r, c, 1, 1]
            p, q = g * e - h * d, h * a - g * b
            s, t = i * e - j * d, j * a - i * b
            # It takes (down, right) to (p, s) and (q, t); s - q is its sine counter-clockwise.
            angle[r, c] -= math.atan2(s - q, p + t)
    return offsets, jacobian, angle


@numba.njit(cache=True, inline="always")
def _weights(t: float) -> tuple[float, float, float, float]:
    """Return the weights of cubic interpolation (Catmull and Rom, 1974)."""
    s = 1 - t
    return -t * s * s / 2, 1 + t * t * (3 * t - 5) / 2, 1 + s * s * (3 * s - 5) / 2, -s * t * t / 2


@numba.njit(**PART)
def _interpolated(vectors: Float32, y: float, x: float, out: Float32) -> None:
    """Add the cubic interpolation of a map to a vector; its border continues it."""
    rows, columns = vectors.shape[0], vectors.shape[1]
    top, left = math.floor(y), math.floor(x)
    down, across = _weights(y - top), _weights(x - left)
    for i in range(4):
        if down[i] == 0:
            continue
        r = min(max(top - 1 + i, 0), rows - 1)
        for j in range(4):
            if across[j] == 0:
                continue
            c = min(max(left - 1 + j, 0), columns - 1)
            for k in range(3):
                out[k] += np.float32(down[i] * across[j]) * vectors[r, c, k]


@numba.njit(cache=True, inline="always")
def _angle(vector: Float32) -> float:
    return math.atan2(math.sqrt(vector[0] * vector[0] + vector[1] * vector[1]), vector[2])


@numba.njit(**PART)
def _make_as_steep(patch: Float32, vectors: Float32, y: int, x: int, offsets: Float32) -> None:
    """Multiply the slopes of a patch so that its mean angle is that of its nearest pixels."""
    size, wanted, gain = patch.shape[0], 0.0, 1.0
    for r in range(size):
        for c in range(size):
            down, right = math.floor(offsets[r, c, 0] + 0.5), math.floor(offsets[r, c, 1] + 0.5)
            wanted += _angle(vectors[y + down, x + right])
    # Angles are not proportional to slopes.
    for _ in range(_ROUNDS):
        found = 0.0
        for r in range(size):
            for c in range(size):
                found += _angle(patch[r, c])
        if found <= 0:
            return
        factor = min(wanted / found, _MOST_GAIN / gain)
        gain *= factor
        for r in range(size):
            for c in range(size):
                nx, ny = factor * patch[r, c, 0], factor * patch[r, c, 1]
                length = math.sqrt(nx * nx + ny * ny + patch[r, c, 2] ** 2)
                patch[r, c, 0] = nx / length
                patch[r, c, 1] = ny / length
                patch[r, c, 2] /= length


@numba.njit(**PART)
def sampled(
    vectors: Float32, y: int, x: int, offsets: Float32, jacobian: Float32, turned: Float32
) -> Float32:
    """Return the vectors of an exemplar in the pixels of a patch.

    Parameters
    ----------
    vectors
        ``(h, w, 3)`` exemplar.
    y, x
        Place of the centre of the patch.
    offsets, jacobian, turned
        Map of the patch, see `patch_map`.

    Returns
    -------
    Float
        ``(n, n, 3)`` unit vectors. A pixel that is larger than one of the exemplar is the mean over
        the additional extent along the axes of its footprint. One factor on the slopes, at most
        1.5, makes the patch as steep as the nearest pixels of the exemplar.
    """
    size = offsets.shape[0]
    out = np.zeros((size, size, 3), np.float32)
    total = np.zeros(3, np.float32)
    for r in range(size):
        for c in range(size):
            a, b = jacobian[r, c, 0, 0], jacobian[r, c, 0, 1]
            d, e = jacobian[r, c, 1, 0], jacobian[r, c, 1, 1]
            # Axes of the ellipse that a circle becomes: eigenvectors of J J^T.
            xx, xy, yy = a * a + b * b, a * d + b * e, d * d + e * e
            half = (xx - yy) / 2
            root = math.sqrt(half * half + xy * xy)
            tilt = math.atan2(xy, half) / 2
            long, short = (xx + yy) / 2 + root, (xx + yy) / 2 - root
            first, second = math.sqrt(max(long - 1, 0.0)), math.sqrt(max(short - 1, 0.0))
            # Rounding errors of a step of 1 do not blur.
            first, second = first if first > 0.1 else 0.0, second if second > 0.1 else 0.0
            n = min(math.ceil(first) + 1, _MOST_SAMPLES) if first else 1
            m = min(math.ceil(second) + 1, _MOST_SAMPLES) if second else 1
            for k in range(3):
                total[k] = 0
            for i in range(n):
                u = ((i + 0.5) / n - 0.5) * first
                for j in range(m):
                    v = ((j + 0.5) / m - 0.5) * second
                    _interpolated(
                        vectors,
                        y + offsets[r, c, 0] + u * math.cos(tilt) - v * math.sin(tilt),
                        x + offsets[r, c, 1] + u * math.sin(tilt) + v * math.cos(tilt),
                        total,
                    )
            cosine, sine = math.cos(turned[r, c]), math.sin(turned[r, c])
            nx, ny = total[0], total[1]
            length = math.sqrt(nx * nx + ny * ny + total[2] * total[2])
            out[r, c, 0] = (cosine * nx - sine * ny) / length
            out[r, c, 1] = (sine * nx + cosine * ny) / length
            out[r, c, 2] = total[2] / length
    _make_as_steep(out, vectors, y, x, offsets)
    return out
