"""Compiled least squares over the samples of one pixel, shared by the estimators.

numba does not compile a kernel again after a change in a function of another file that it calls.
After a change in this file, the lines "Compiled in" of its callers must change; a test prints them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numba.core.options import DefaultOptions

from rig import in_threads
from rig.arrays import Float32, Float64
from rig.kernels import INLINED

# Most steps of `reweighted`, which ends at one of 3e-4 of the vector's length (0.02 degree). After
# 2 steps samples near the terminator still have weights of the given solution.
_STEPS = 4
_SETTLED2 = 1e-7
# Samples beyond this many standard deviations are outliers, and at most this share may be.
_CUT = 4.0
_OUTLIERS = 0.1
# The sum of the squared, normalised residuals over d degrees of freedom has the standard deviation
# sqrt(2 d). This many are allowed, and some more for errors of the lights.
_CHI2_SIGMAS = 4.0
_TOLERANCE = 1.25
# Largest spread, in standard deviations, from which one more step can reach agreement.
_HOPELESS = 4.0
# Passes that locate a rank, each in a quarter of the range before: to 1 part in 64, a tenth of the
# noise of a median.
_PASSES = 3
# 1 / (0.75 quantile of the normal distribution): converts the median of |r| into a standard
# deviation.
MAD_TO_SIGMA = 1.4826
# Largest condition number of the lights: the errors of the images are multiplied by up to this
# factor. A dome has 2 to 5, a cone of 3 degrees about 30, a row of lights whose directions are
# wrong by one degree about 50.
MAX_CONDITION = 30.0
# trace(A) * trace(A^-1) is between the squared condition number and 9 times that, so this limit
# rejects no pixel that is reached by all the lights of an accepted set.
_CONDITION2 = 9.0 * MAX_CONDITION**2
# A matrix within the limit has a larger determinant, relative to its cubed trace.
_LEAST_DETERMINANT = 1 / (3**3 * _CONDITION2**2)
# Sums may be evaluated in any order, so that they vectorise; see `INLINED`.
ANY_ORDER = {"reassoc", "contract", "nsz"}
# Options of functions of single pixels, which allocate nothing: otherwise numba counts references
# to every row that they use, which takes up to half of their time. The option is not documented; a
# numba without it is slower and gives the same results.
IN_PLACE: dict[str, Any] = dict(INLINED)
if hasattr(DefaultOptions, "_nrt"):
    IN_PLACE["_nrt"] = False


def solved_pixels(
    kernel: Callable[..., None], values: Float32, vectors: Float32, law: Float32 | None, *more: Any
) -> tuple[Float64, Float64]:
    """Return the scaled normals and residuals that a kernel writes; see `Estimator`."""
    scaled, rms = np.zeros((len(values), 3)), np.zeros(len(values))
    of_noise = law_or_alike(law, values.shape[1])
    in_threads(kernel, len(values), values, vectors, *of_noise, *more, scaled, rms)
    return scaled, rms


def law_or_alike(law: Float32 | None, lights: int) -> tuple[Float32, bool]:
    """Return a law of the noise and whether it is known; an unknown one weights all samples alike.

    See `Estimator`.
    """
    if law is not None:
        return law, True
    alike = np.zeros((1, 2, lights), np.float32)
    alike[:, 0] = 1
    return alike, False


@numba.njit(**IN_PLACE)
def usable_samples(values: Float32, vectors: Float32, law: Float32, usable: Float32) -> int:
    """Copy the finite samples of one pixel, their light vectors and noise; return their number.

    ``values`` is ``(N,)``, ``vectors`` ``(3, N)``, ``law`` ``(2, N)``, and ``usable`` ``(6, N)``:
    value, x, y, z, variance without light and per value.
    """
    v, lx, ly, lz, floor, slope = usable[0], usable[1], usable[2], usable[3], usable[4], usable[5]
    measured = np.int32(0)
    for i in range(len(values)):
        measured += np.int32(abs(values[i]) < np.float32(np.inf))
    if measured == len(values):
        for i in range(len(values)):
            v[i], lx[i], ly[i], lz[i] = values[i], vectors[0, i], vectors[1, i], vectors[2, i]
            floor[i], slope[i] = law[0, i], law[1, i]
        return len(values)
    count = 0
    for i in range(len(values)):
        if math.isfinite(values[i]):
            v[count] = values[i]
            lx[count] = vectors[0, i]
            ly[count] = vectors[1, i]
            lz[count] = vectors[2, i]
            floor[count] = law[0, i]
            slope[count] = law[1, i]
            count += 1
    return count


@numba.njit(**IN_PLACE)
def _solve(
    a00: float, a01: float, a02: float, a11: float, a12: float, a22: float,
    b0: float, b1: float, b2: float,
) -> tuple[bool, float, float, float]:  # fmt: skip
    """Solve a symmetric 3 x 3 system by cofactors; return False if it is ill-conditioned."""
    c00 = a11 * a22 - a12 * a12
    c01 = a02 * a12 - a01 * a22
    c02 = a01 * a12 - a02 * a11
    c11 = a00 * a22 - a02 * a02
    c12 = a01 * a02 - a00 * a12
    c22 = a00 * a11 - a01 * a01
    determinant = a00 * c00 + a01 * c01 + a02 * c02
    trace = a00 + a11 + a22
    # The cofactors of a single light are rounding errors, as is the determinant.
    if not (
        trace * (c00 + c11 + c22) < _CONDITION2 * determinant
        and determinant > _LEAST_DETERMINANT * trace**3
    ):
        return False, 0.0, 0.0, 0.0
    return (
        True,
        (c00 * b0 + c01 * b1 + c02 * b2) / determinant,
        (c01 * b0 + c11 * b1 + c12 * b2) / determinant,
        (c02 * b0 + c12 * b1 + c22 * b2) / determinant,
    )


@numba.njit(**IN_PLACE, fastmath=ANY_ORDER)
def normal_equations(
    count: int, usable: Float32, weight: Float32
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Return the 6 sums of the matrix and the 3 of the right-hand side of least squares."""
    v, lx, ly, lz = usable[0], usable[1], usable[2], usable[3]
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
    return a00, a01, a02, a11, a12, a22, b0, b1, b2


@numba.njit(**IN_PLACE, fastmath=ANY_ORDER)
def weighted_solution(
    count: int, usable: Float32, weight: Float32
) -> tuple[bool, float, float, float]:
    """Solve ``v = l . m`` by weighted least squares over the first ``count`` samples.

    Returns whether the lights determine ``m``, and its three components. Sums are float64.
    """
    a00, a01, a02, a11, a12, a22, b0, b1, b2 = normal_equations(count, usable, weight)
    solution: tuple[bool, float, float, float] = _solve(a00, a01, a02, a11, a12, a22, b0, b1, b2)
    return solution


@numba.njit(**IN_PLACE, fastmath=ANY_ORDER)
def rms_residual(count: int, usable: Float32, m0: float, m1: float, m2: float) -> float:
    """Return the root mean square of ``v - l . m`` over the first ``count`` samples."""
    total = 0.0
    for k in range(count):
        shading = usable[1, k] * m0 + usable[2, k] * m1 + usable[3, k] * m2
        total += (usable[0, k] - shading) ** 2
    return math.sqrt(total / count)


@numba.njit(**IN_PLACE)
def count_up_to(values: Float32, count: int, limit: np.float32) -> int:
    """Return how many of the first ``count`` values do not exceed a limit."""
    found = np.int32(0)
    for k in range(count):
        found += np.int32(values[k] <= limit)
    return int(found)


@numba.njit(**IN_PLACE)
def _count_up_to_three(
    values: Float32, count: int, a: np.float32, b: np.float32, c: np.float32
) -> tuple[int, int, int]:
    """Return how many of the first ``count`` values do not exceed each of three limits."""
    below_a = below_b = below_c = np.int32(0)
    for k in range(count):
        below_a += np.int32(values[k] <= a)
        below_b += np.int32(values[k] <= b)
        below_c += np.int32(values[k] <= c)
    return int(below_a), int(below_b), int(below_c)


@numba.njit(**IN_PLACE)
def ranked(values: Float32, count: int, rank: int, guess: np.float32) -> np.float32:
    """Return a limit that slightly more than ``rank`` of the values, all positive, do not exceed.

    The search starts at a guess above 0 and divides the range by four in each pass. The code
    branches once per pass and not per sample, so it is faster than a selection algorithm.
    """
    low, high, half = np.float32(0), guess, np.float32(0.5)
    while high < np.inf and count_up_to(values, count, high) <= rank:
        low, high = high, 2 * high
    for _ in range(_PASSES):
        b = half * (low + high)
        a, c = half * (low + b), half * (b + high)
        up_to_a, up_to_b, up_to_c = _count_up_to_three(values, count, a, b, c)
        if up_to_a > rank:
            high = a
        elif up_to_b > rank:
            low, high = a, b
        elif up_to_c > rank:
            low, high = b, c
        else:
            low = c
    return high


@numba.njit(**IN_PLACE, error_model="numpy")
def reweighted(
    count: int, usable: Float32, scratch: Float32, m0: float, m1: float, m2: float
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
    settled = False
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
        if settled or step == _STEPS:
            free = lit - 3.0
            most = _TOLERANCE * (free + _CHI2_SIGMAS * math.sqrt(2.0 * free))
            if agree >= count * (1.0 - _OUTLIERS) and total <= most:
                return True, n0, n1, n2
            break
        solved, x0, x1, x2 = weighted_solution(count, usable, weight)
        if not solved:
            break
        step2 = (x0 - n0) ** 2 + (x1 - n1) ** 2 + (x2 - n2) ** 2
        settled = step2 <= _SETTLED2 * (x0 * x0 + x1 * x1 + x2 * x2)
        n0, n1, n2 = x0, x1, x2
    return False, m0, m1, m2
