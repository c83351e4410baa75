"""What a reflectance of two coefficients leaves of the residuals of a pixel, compiled."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from processing._stereo.pixel_algebra import IN_PLACE
from processing._stereo.ranks import MAD_TO_SIGMA, ranked

# Compiled in: processing/_stereo/pixel_algebra.py d36a51d0daee
# Compiled in: processing/_stereo/ranks.py 785cb2179947

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Kinds = npt.NDArray[np.uint8]

_STEPS = 3
# Samples further away than this many standard deviations do not agree.
_CUT = 4.0
# Samples of lights that the surface faces less, relative to the albedo, are left out.
_FACING = 0.02
# Nearly collinear coefficients are drawn toward 0.
_RIDGE = 1e-6
# The values of `SampleKind`, for the compiler.
_LIT, _OUTLIER = 0, 4


@numba.njit(**IN_PLACE, error_model="numpy")
def reflectance_left(
    count: int, samples: Float, kinds: Kinds, index: npt.NDArray[np.int64], start: Double,
    point: Double, view: Double, near: bool, scratch: Float,
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
    shading, gloss = scratch[0], samples[7]
    distance, agreeing, weight = scratch[1], scratch[2], scratch[3]
    length = math.sqrt(start[0] ** 2 + start[1] ** 2 + start[2] ** 2)
    nx, ny, nz = start[0] / length, start[1] / length, start[2] / length
    ex, ey, ez = 0.0, 0.0, 1.0
    if near and (view[0] != 0 or view[1] != 0 or view[2] != 0):
        ex, ey, ez = view[0] - point[0], view[1] - point[1], view[2] - point[2]
        away = math.sqrt(ex * ex + ey * ey + ez * ez)
        ex, ey, ez = ex / away, ey / away, ez / away
    for k in range(count):
        lx, ly, lz = float(samples[1, k]), float(samples[2, k]), float(samples[3, k])
        size = math.sqrt(lx * lx + ly * ly + lz * lz)
        shading[k] = lx * nx + ly * ny + lz * nz
        hx, hy, hz = lx / size + ex, ly / size + ey, lz / size + ez
        along = hx * nx + hy * ny + hz * nz
        gloss[k] = shading[k] * along * along / (hx * hx + hy * hy + hz * hz)
        kind = kinds[index[k]]
        usable = shading[k] > _FACING * size and kind in (_LIT, _OUTLIER)
        weight[k] = 1.0 if usable and kind == _LIT else 0.0
        distance[k] = 0.0 if usable else -1.0
    total, used = 0.0, 0
    for _ in range(_STEPS):
        a = b = c = p = q = 0.0
        for k in range(count):
            if weight[k] > 0:
                v = samples[0, k]
                w = 1.0 / (samples[4, k] + samples[5, k] * max(v, np.float32(0)) + samples[6, k])
                a += w * shading[k] * shading[k]
                b += w * shading[k] * gloss[k]
                c += w * gloss[k] * gloss[k]
                p += w * shading[k] * v
                q += w * gloss[k] * v
        c *= 1 + _RIDGE
        determinant = a * c - b * b
        if not determinant > 0:
            return np.inf
        matte, more = (c * p - b * q) / determinant, (a * q - b * p) / determinant
        used = 0
        for k in range(count):
            if distance[k] >= 0:
                expected = max(matte * shading[k] + more * gloss[k], 0.0)
                variance = samples[4, k] + samples[5, k] * expected + samples[6, k]
                distance[k] = abs(samples[0, k] - expected) / math.sqrt(variance)
                agreeing[used] = distance[k]
                used += int(weight[k] > 0)
        scale = np.float32(MAD_TO_SIGMA) * ranked(agreeing, used, used // 2, np.float32(1))
        limit = _CUT * max(float(scale), 1.0)
        total, used = 0.0, 0
        for k in range(count):
            agrees = 0 <= distance[k] <= limit
            weight[k] = 1.0 if agrees else 0.0
            total += float(distance[k]) ** 2 if agrees else 0.0
            used += int(agrees)
    return total / (used - 2.0) if used > 2 else np.inf
