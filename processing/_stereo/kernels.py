"""Photometric stereo over the rows of a stack, compiled.

One pass over the stack, so memory grows by the output alone. Every pixel is computed on its own and
in a fixed order: the result does not depend on the number of threads. All kernels are in this one
file because numba's cache of a kernel looks at the kernel's own file and not at those it calls.
"""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]

# A row of lights whose directions are wrong by a degree has about 50, a cone of 3 degrees 30, a
# dome 2 to 5: what lies above multiplies every error of the images by as much.
MAX_CONDITION = 30.0
# trace(A) * trace(A^-1) is between the squared condition number and 9 times that: this refuses no
# pixel that sees all the lights of an accepted set.
_CONDITION2 = 9.0 * MAX_CONDITION**2
# Sums may be taken in any order, so that they vectorise; the order is the same in every run.
_ANY_ORDER = {"reassoc", "contract", "nsz"}
_ITERATIONS = 10
# 1 / (0.75 quantile of the normal distribution): turns the median of |r| into a deviation.
_MAD_TO_SIGMA = 1.4826
# Halvings that find the median; it is then known to 1 part in 250, a tenth of its own noise.
_HALVINGS = 8
# Steps of 1e-5 of the vector's length (0.0006 degree) end the iteration.
_STEP2 = 1e-10
# The smallest scale of the weights, relative to the vector's length: exact data has no spread.
_SCALE_FLOOR = 1e-6
# Columns that are copied together into a scratch tile: with images of 2^n pixels the samples of one
# pixel would evict each other from the cache. The odd multiple of 16 spreads the tile's own rows.
_TILE = 64
_STRIDE = 80


@numba.njit(cache=True)
def _solve(
    a00: float, a01: float, a02: float, a11: float, a12: float, a22: float,
    b0: float, b1: float, b2: float,
) -> tuple[bool, float, float, float]:  # fmt: skip
    """Solve a symmetric 3 x 3 system by cofactors; False where it is ill-conditioned."""
    c00 = a11 * a22 - a12 * a12
    c01 = a02 * a12 - a01 * a22
    c02 = a01 * a12 - a02 * a11
    c11 = a00 * a22 - a02 * a02
    c12 = a01 * a02 - a00 * a12
    c22 = a00 * a11 - a01 * a01
    determinant = a00 * c00 + a01 * c01 + a02 * c02
    if not (a00 + a11 + a22) * (c00 + c11 + c22) < _CONDITION2 * determinant:
        return False, 0.0, 0.0, 0.0
    return (
        True,
        (c00 * b0 + c01 * b1 + c02 * b2) / determinant,
        (c01 * b0 + c11 * b1 + c12 * b2) / determinant,
        (c02 * b0 + c12 * b1 + c22 * b2) / determinant,
    )


@numba.njit(cache=True, fastmath=_ANY_ORDER)
def _weighted(
    count: int, v: Float, lx: Float, ly: Float, lz: Float, weight: Float
) -> tuple[bool, float, float, float]:
    """Weighted least squares of ``v = l . m`` over the first ``count`` samples, float64 sums."""
    a00 = a01 = a02 = a11 = a12 = a22 = b0 = b1 = b2 = 0.0
    for k in range(count):
        x, y, z = lx[k], ly[k], lz[k]
        wx, wy, wz = weight[k] * x, weight[k] * y, weight[k] * z
        a00 += wx * x
        a01 += wx * y
        a02 += wx * z
        a11 += wy * y
        a12 += wy * z
        a22 += wz * z
        b0 += wx * v[k]
        b1 += wy * v[k]
        b2 += wz * v[k]
    return _solve(a00, a01, a02, a11, a12, a22, b0, b1, b2)


@numba.njit(cache=True)
def _count_up_to(values: Float, count: int, limit: np.float32) -> int:
    found = np.int32(0)
    for k in range(count):
        found += np.int32(values[k] <= limit)
    return int(found)


@numba.njit(cache=True)
def _median(values: Float, count: int, guess: np.float32) -> np.float32:
    """Return the upper median of positive values, by halving from a guess above 0.

    A branch per halving and none per sample: four times the speed of a selection.
    """
    low, high = np.float32(0), guess
    while high < np.inf and _count_up_to(values, count, high) <= count // 2:
        low, high = high, 2 * high
    for _ in range(_HALVINGS):
        middle = np.float32(0.5) * (low + high)
        if _count_up_to(values, count, middle) > count // 2:
            high = middle
        else:
            low = middle
    return high


@numba.njit(cache=True)
def _cauchy(
    count: int, v: Float, lx: Float, ly: Float, lz: Float, shading: Float, deviation: Float,
    m0: float, m1: float, m2: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Refine the least-squares solution (m0, m1, m2) of ``v = max(l . m, 0)``.

    Iteratively reweighted least squares with the Cauchy weight ``1 / (1 + (r / s)^2)``, s the
    scaled median of |r| (Holland, Welsch, 1977). Lights that the surface faces away from predict
    black and carry no slope: they count for the scale and have no weight. ``shading`` and
    ``deviation`` are scratch of at least ``count``.
    """
    zero, one = np.float32(0), np.float32(1)
    guess = np.float32(0.01 * math.sqrt(m0 * m0 + m1 * m1 + m2 * m2))
    for _ in range(_ITERATIONS):
        length2 = m0 * m0 + m1 * m1 + m2 * m2
        floor = np.float32(_SCALE_FLOOR * math.sqrt(length2))
        if not floor > 0:
            break
        x, y, z = np.float32(m0), np.float32(m1), np.float32(m2)
        for k in range(count):
            shading[k] = lx[k] * x + ly[k] * y + lz[k] * z
            deviation[k] = abs(v[k] - max(shading[k], zero))
        guess = _median(deviation, count, max(guess, floor))
        per_scale = one / (np.float32(_MAD_TO_SIGMA) * guess + floor)
        weight = shading
        for k in range(count):
            ratio = deviation[k] * per_scale
            weight[k] = one / (one + ratio * ratio) if shading[k] > zero else zero
        solved, n0, n1, n2 = _weighted(count, v, lx, ly, lz, weight)
        if not solved:
            break
        step2 = (n0 - m0) ** 2 + (n1 - m1) ** 2 + (n2 - m2) ** 2
        m0, m1, m2 = n0, n1, n2
        if step2 <= _STEP2 * length2:
            break
    return m0, m1, m2


@numba.njit(cache=True)
def _irradiance(x: float, y: float, z: float, reference: float, axis: Double, mu: float) -> float:
    """Return what turns (x, y, z), from a point to an LED, into its light vector; see Lights."""
    distance2 = x * x + y * y + z * z
    distance = math.sqrt(distance2)
    cosine = -(x * axis[0] + y * axis[1] + z * axis[2])
    # Also false for a point that is not finite.
    if not cosine > 0.0:
        return 0.0
    gain = reference / (distance2 * distance)
    if mu == 0.0:
        return float(gain)
    if mu == 1.0:
        return float(gain * cosine / distance)
    return float(gain * (cosine / distance) ** mu)


@numba.njit(cache=True)
def _sums(tile: Float, columns: int, directions: Double, sums: Double) -> None:
    """Write the sums of ``lx v``, ``ly v``, ``lz v`` and ``v v`` over the lights, per column."""
    sums[:] = 0.0
    bx, by, bz, vv = sums[0], sums[1], sums[2], sums[3]
    for i in range(len(tile)):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        samples = tile[i]
        for j in range(columns):
            sample = np.float64(samples[j])
            bx[j] += x * sample
            by[j] += y * sample
            bz[j] += z * sample
            vv[j] += sample * sample


@numba.njit(cache=True)
def _gather_distant(samples: Float, directions: Double, gathered: Float) -> int:
    """Copy the finite samples of one pixel and their light vectors; return their number."""
    v, lx, ly, lz = gathered[0], gathered[1], gathered[2], gathered[3]
    count = 0
    for i in range(len(samples)):
        if math.isfinite(samples[i]):
            v[count] = samples[i]
            lx[count] = directions[i, 0]
            ly[count] = directions[i, 1]
            lz[count] = directions[i, 2]
            count += 1
    return count


@numba.njit(cache=True)
def _gather_near(
    samples: Float, point: Double, positions: Double, axes: Double, mu: Double, reference: Double,
    gathered: Float,
) -> int:  # fmt: skip
    """Do the same with the light vectors at a point; LEDs that cannot reach it are left out."""
    v, lx, ly, lz = gathered[0], gathered[1], gathered[2], gathered[3]
    count = 0
    for i in range(len(samples)):
        if math.isfinite(samples[i]):
            x = positions[i, 0] - point[0]
            y = positions[i, 1] - point[1]
            z = positions[i, 2] - point[2]
            gain = _irradiance(x, y, z, reference[i], axes[i], mu[i])
            if gain > 0.0:
                v[count] = samples[i]
                lx[count] = x * gain
                ly[count] = y * gain
                lz[count] = z * gain
                count += 1
    return count


@numba.njit(cache=True)
def _rms(count: int, gathered: Float, m0: float, m1: float, m2: float) -> float:
    total = 0.0
    for k in range(count):
        shading = gathered[1, k] * m0 + gathered[2, k] * m1 + gathered[3, k] * m2
        total += (gathered[0, k] - shading) ** 2
    return math.sqrt(total / count)


@numba.njit(parallel=True, cache=True)
def solve_rows(
    values: Float, mask: npt.NDArray[np.bool_], first: int, last: int,
    directions: Double, inverse: Double,
    near: bool, positions: Double, axes: Double, mu: Double, reference: Double, points: Double,
    robust: bool,
    normals: Float, albedo: Float, residual: Float, used: npt.NDArray[np.uint16],
) -> None:  # fmt: skip
    """Solve the masked pixels of the rows ``first .. last - 1`` into the last four arrays.

    ``inverse`` is the inverse of ``directions.T @ directions``, for distant lights.
    ``reference`` is ``r0^2 / cos(t0)^mu`` per near light, so that its irradiance at the origin is
    1; ``points`` is ``(H, W, 3)``. A normal is left 0 where fewer than 3 samples are finite, where
    their lights are ill-conditioned, and where all are black.
    """
    lights, _, width = values.shape
    for row in numba.prange(first, last):
        tile = np.zeros((lights, _STRIDE), np.float32)
        gathered = np.zeros((4, lights), np.float32)
        scratch = np.zeros((2, lights), np.float32)
        sums = np.zeros((4, _TILE))
        for start in range(0, width, _TILE):
            columns = min(_TILE, width - start)
            if not mask[row, start : start + columns].any():
                continue
            for i in range(lights):
                tile[i, :columns] = values[i, row, start : start + columns]
            if not near:
                _sums(tile, columns, directions, sums)
            for j in range(columns):
                column = start + j
                if not mask[row, column]:
                    continue
                # One sample that is not finite leaves its mark in the sum of squares.
                complete = not near and math.isfinite(sums[3, j])
                if near:
                    count = _gather_near(
                        tile[:, j], points[row, column], positions, axes, mu, reference, gathered
                    )
                elif robust or not complete:
                    count = _gather_distant(tile[:, j], directions, gathered)
                else:
                    count = lights
                used[row, column] = count
                if complete:
                    solved = True
                    b0, b1, b2 = sums[0, j], sums[1, j], sums[2, j]
                    m0 = inverse[0, 0] * b0 + inverse[0, 1] * b1 + inverse[0, 2] * b2
                    m1 = inverse[1, 0] * b0 + inverse[1, 1] * b1 + inverse[1, 2] * b2
                    m2 = inverse[2, 0] * b0 + inverse[2, 1] * b1 + inverse[2, 2] * b2
                    rms = math.sqrt(max(sums[3, j] - (m0 * b0 + m1 * b1 + m2 * b2), 0.0) / lights)
                else:
                    v, lx, ly, lz = gathered[0], gathered[1], gathered[2], gathered[3]
                    scratch[0, :count] = 1.0
                    solved, m0, m1, m2 = _weighted(count, v, lx, ly, lz, scratch[0])
                    rms = _rms(count, gathered, m0, m1, m2) if solved else 0.0
                if solved and robust:
                    v, lx, ly, lz = gathered[0], gathered[1], gathered[2], gathered[3]
                    m0, m1, m2 = _cauchy(count, v, lx, ly, lz, scratch[0], scratch[1], m0, m1, m2)
                    rms = _rms(count, gathered, m0, m1, m2)
                length = math.sqrt(m0 * m0 + m1 * m1 + m2 * m2)
                if not (solved and np.float32(length) > 0.0):
                    continue
                normals[row, column, 0] = m0 / length
                normals[row, column, 1] = m1 / length
                normals[row, column, 2] = m2 / length
                albedo[row, column] = length
                residual[row, column] = rms
