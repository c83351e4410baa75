"""What a reflectance of two coefficients leaves of the residuals of a pixel, compiled.

Each loop over samples writes one array, in float32 and without branches, so that it vectorises.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from processing.stereo.pixel_algebra import ANY_ORDER, IN_PLACE, MAD_TO_SIGMA, ranked
from rig.arrays import Float32, Float64, Int64, UInt8

# Compiled in: processing/stereo/pixel_algebra.py f495374b06dc

_STEPS = 3
# Samples further away than this many standard deviations do not agree.
_CUT = 4.0
# Samples of lights that the surface faces less, relative to the albedo, are left out.
_FACING = 0.02
# Nearly collinear coefficients are drawn toward 0.
_RIDGE = 1e-6
# The values of `SampleKind`, for the compiler.
_LIT, _OUTLIER = 0, 4


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=ANY_ORDER)
def reflectance_left(
    count: int, samples: Float32, kinds: UInt8, index: Int64, start: Float64,
    point: Float64, view: Float64, near: bool, scratch: Float32,
) -> float:  # fmt: skip
    """Return the mean square of the normalised residuals of ``(l . n) (c0 + c1 (h . n)^2)``.

    The normal is the given one, and h the half vector between light and camera, as in the
    method ``best``. If it explains the samples that a matte surface does not, it is better
    than the reference. Infinite if too few samples agree.

    Parameters
    ----------
    count, samples, kinds, index, start, point, view, near, scratch
        As in the solution of a pixel, `reference_solutions`; scratch and the last row of the
        samples are overwritten.
    """
    v, lx, ly, lz = samples[0], samples[1], samples[2], samples[3]
    floor, slope, of_light, gloss = samples[4], samples[5], samples[6], samples[7]
    shading, distance, agreeing, weight = scratch[0], scratch[1], scratch[2], scratch[3]
    zero, one, infinite = np.float32(0), np.float32(1), np.float32(np.inf)
    length = math.sqrt(start[0] ** 2 + start[1] ** 2 + start[2] ** 2)
    nx, ny = np.float32(start[0] / length), np.float32(start[1] / length)
    nz = np.float32(start[2] / length)
    toward_x, toward_y, toward_z = 0.0, 0.0, 1.0
    if near and (view[0] != 0 or view[1] != 0 or view[2] != 0):
        toward_x, toward_y, toward_z = view[0] - point[0], view[1] - point[1], view[2] - point[2]
    away = math.sqrt(toward_x**2 + toward_y**2 + toward_z**2)
    ex, ey, ez = (
        np.float32(toward_x / away),
        np.float32(toward_y / away),
        np.float32(toward_z / away),
    )
    for k in range(count):
        weight[k] = kinds[index[k]]
    for k in range(count):
        shading[k] = lx[k] * nx + ly[k] * ny + lz[k] * nz
    for k in range(count):
        per = one / np.sqrt(lx[k] * lx[k] + ly[k] * ly[k] + lz[k] * lz[k])
        hx, hy, hz = lx[k] * per + ex, ly[k] * per + ey, lz[k] * per + ez
        along = hx * nx + hy * ny + hz * nz
        gloss[k] = shading[k] * along * along / (hx * hx + hy * hy + hz * hz)
    for k in range(count):
        size = np.sqrt(lx[k] * lx[k] + ly[k] * ly[k] + lz[k] * lz[k])
        measured = (weight[k] == np.float32(_LIT)) | (weight[k] == np.float32(_OUTLIER))
        distance[k] = zero if (shading[k] > np.float32(_FACING) * size) & measured else -one
    for k in range(count):
        weight[k] = one if (distance[k] == zero) & (weight[k] == np.float32(_LIT)) else zero
    total, used = 0.0, np.int32(0)
    for _ in range(_STEPS):
        a = b = c = p = q = 0.0
        for k in range(count):
            variance = floor[k] + slope[k] * max(v[k], zero) + of_light[k]
            w = weight[k] / variance
            of_shading, of_gloss = w * shading[k], w * gloss[k]
            a += of_shading * shading[k]
            b += of_shading * gloss[k]
            c += of_gloss * gloss[k]
            p += of_shading * v[k]
            q += of_gloss * v[k]
        c *= 1 + _RIDGE
        determinant = a * c - b * b
        if not determinant > 0:
            return np.inf
        matte = np.float32((c * p - b * q) / determinant)
        more = np.float32((a * q - b * p) / determinant)
        for k in range(count):
            expected = max(matte * shading[k] + more * gloss[k], zero)
            own = abs(v[k] - expected) / np.sqrt(floor[k] + slope[k] * expected + of_light[k])
            distance[k] = own if distance[k] >= zero else -one
        used = np.int32(0)
        for k in range(count):
            agreeing[k] = distance[k] if weight[k] > zero else infinite
            used += np.int32(weight[k] > zero)
        scale = np.float32(MAD_TO_SIGMA) * ranked(agreeing, count, used // 2, one)
        limit = np.float32(_CUT) * max(scale, one)
        for k in range(count):
            weight[k] = one if (distance[k] >= zero) & (distance[k] <= limit) else zero
        total, used = 0.0, np.int32(0)
        for k in range(count):
            total += float(weight[k] * distance[k] * distance[k])
            used += np.int32(weight[k] > zero)
    return total / (used - 2.0) if used > 2 else np.inf
