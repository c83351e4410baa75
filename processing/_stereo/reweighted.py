"""Last step of the estimators: weighted least squares where the residuals are known noise."""

from __future__ import annotations

import math

import numba
import numpy as np

from processing._stereo.pixel_algebra import IN_PLACE, Float, weighted_solution
from processing._stereo.ranks import MAD_TO_SIGMA, ranked

# Compiled in: processing/_stereo/pixel_algebra.py d36a51d0daee
# Compiled in: processing/_stereo/ranks.py 785cb2179947

_STEPS = 2
# Samples beyond this many standard deviations are outliers, and at most this share may be.
_CUT = 4.0
_OUTLIERS = 0.1
# The sum of the squared, normalised residuals over d degrees of freedom has the standard deviation
# sqrt(2 d). This many are allowed, and some more for errors of the lights.
_CHI2_SIGMAS = 4.0
_TOLERANCE = 1.25
# Largest spread, in standard deviations, from which one more step can reach agreement.
_HOPELESS = 4.0


@numba.njit(**IN_PLACE, error_model="numpy")
def reweighted(
    count: int, usable: Float, scratch: Float, m0: float, m1: float, m2: float
) -> tuple[bool, float, float, float]:
    """Refine a solution of ``v = max(l . m, 0)`` where the residuals are noise.

    The weights are the reciprocal variances at the predicted signals, so that the error is that of
    the Cramer-Rao bound. Return False and the given solution if the residuals are not noise:
    another reflectance, many highlights or shadows.

    Parameters
    ----------
    count, usable
        Samples of one pixel with the law of their noise, see `usable_samples`.
    scratch
        At least 3 rows of ``count`` elements.
    m0, m1, m2
        The given solution.
    """
    v, lx, ly, lz, floor, slope = usable[0], usable[1], usable[2], usable[3], usable[4], usable[5]
    ratio, weight, of_lit = scratch[0], scratch[1], scratch[2]
    n0, n1, n2 = m0, m1, m2
    zero, one = np.float32(0), np.float32(1)
    for step in range(_STEPS + 1):
        x, y, z = np.float32(n0), np.float32(n1), np.float32(n2)
        lit = 0
        for k in range(count):
            shading = max(lx[k] * x + ly[k] * y + lz[k] * z, zero)
            precision = one / (floor[k] + slope[k] * shading)
            ratio[k] = abs(v[k] - shading) * np.sqrt(precision)
            # A sample that the model predicts black has no slope.
            weight[k] = precision if shading > zero else zero
            of_lit[lit] = ratio[k]
            lit += int(weight[k] > zero)
        if lit < 3:
            break
        scale = np.float32(MAD_TO_SIGMA) * ranked(of_lit, lit, lit // 2, one)
        if step > 0 and scale > _HOPELESS:
            break
        limit = np.float32(_CUT) * max(scale, one)
        agree, total = 0, 0.0
        for k in range(count):
            if ratio[k] <= limit:
                agree += 1
                total += float(ratio[k]) ** 2 if weight[k] > zero else 0.0
            else:
                weight[k] = zero
        if step == _STEPS:
            free = lit - 3.0
            most = _TOLERANCE * (free + _CHI2_SIGMAS * math.sqrt(2.0 * free))
            if agree >= count * (1.0 - _OUTLIERS) and total <= most:
                return True, n0, n1, n2
            break
        solved, n0, n1, n2 = weighted_solution(count, usable, weight)
        if not solved:
            break
    return False, m0, m1, m2
