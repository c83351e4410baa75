"""What the samples of a pixel are, compared with a prediction, compiled.

A loop that writes several arrays does not vectorise: the compiler would have to test too many of
them for overlap. Each loop over samples therefore writes one array.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from processing.stereo.pixel_algebra import ANY_ORDER, IN_PLACE, MAD_TO_SIGMA, ranked
from rig.arrays import Float32, Float64, Int64, UInt8, UInt16

# Compiled in: processing/stereo/pixel_algebra.py f495374b06dc

# Samples further away than this many standard deviations do not agree.
_CUT = 4.0
# A cast shadow has less than this share of the predicted signal. If the samples of the pixel
# scatter more than the law says, so that it is no outlier by this scatter, less than the other one.
_SHADOWED, _DEEP = 0.5, 0.25
# Least variance relative to the square of the albedo: exact data have no noise.
_LEAST_VARIANCE = np.float32(1e-12)
# The values of `SampleKind`, for the compiler.
LIT = 0
ATTACHED, CAST, SATURATED, _OUTLIER, _MISSING = 1, 2, 3, 4, 5


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=ANY_ORDER)
def usable_parts(
    values: Float32, vectors: Float32, law: Float32, per: float, samples: Float32,
    index: Int64, kinds: UInt8,
) -> tuple[int, float]:  # fmt: skip
    """Copy the measured samples, relative to the albedo; return their number and mean."""
    per2, mean = per * per, 0.0
    v, floor, slope = samples[0], samples[4], samples[5]
    measured = np.int32(0)
    for i in range(len(values)):
        measured += np.int32(abs(values[i]) < np.float32(np.inf))
    count = int(measured)
    if count == len(values):
        for i in range(count):
            v[i] = values[i] * per
        for c in range(3):
            own, given = samples[1 + c], vectors[c]
            for i in range(count):
                own[i] = given[i]
        for i in range(count):
            floor[i] = law[0, i] * per2 + _LEAST_VARIANCE
        for i in range(count):
            slope[i] = law[1, i] * per
        for i in range(count):
            index[i] = i
    else:
        count = 0
        for i in range(len(values)):
            if math.isfinite(values[i]):
                v[count] = values[i] * per
                for c in range(3):
                    samples[1 + c, count] = vectors[c, i]
                floor[count] = law[0, i] * per2 + _LEAST_VARIANCE
                slope[count] = law[1, i] * per
                index[count] = i
                count += 1
            else:
                # A light that does not reach the point has no vector.
                reached = vectors[0, i] != 0 or vectors[1, i] != 0 or vectors[2, i] != 0
                kinds[i] = SATURATED if reached else _MISSING
    for k in range(count):
        mean += max(v[k], np.float32(0))
    return count, mean / max(count, 1)


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=ANY_ORDER)
def predicted(
    count: int, samples: Float32, m: Float64, shading: Float32, variance: Float32, distance: Float32
) -> int:
    """Write predicted values, their variances, and distances in standard deviations.

    Return how many samples are not further away than the limit for known noise.
    """
    v, lx, ly, lz = samples[0], samples[1], samples[2], samples[3]
    floor, slope, of_light = samples[4], samples[5], samples[6]
    x, y, z, zero = np.float32(m[0]), np.float32(m[1]), np.float32(m[2]), np.float32(0)
    agreeing = np.int32(0)
    for k in range(count):
        shading[k] = lx[k] * x + ly[k] * y + lz[k] * z
    for k in range(count):
        variance[k] = floor[k] + slope[k] * max(shading[k], zero) + of_light[k]
    for k in range(count):
        distance[k] = abs(v[k] - max(shading[k], zero)) / np.sqrt(variance[k])
    for k in range(count):
        agreeing += np.int32(distance[k] <= np.float32(_CUT))
    return int(agreeing)


@numba.njit(**IN_PLACE, error_model="numpy")
def all_agree(
    count: int, v: Float32, dark: np.float32, scratch: Float32, index: Int64,
    kinds: UInt8,
) -> tuple[int, int]:  # fmt: skip
    """Write kinds and weights of samples that all agree; return those lit, and the dark ones.

    Lit samples up to ``dark`` have no weight.
    """
    shading, variance, weight = scratch[0], scratch[1], scratch[3]
    zero, one = np.float32(0), np.float32(1)
    lit, dim = np.int32(0), np.int32(0)
    for k in range(count):
        precision = one / variance[k]
        weight[k] = precision if (shading[k] > zero) & (v[k] > dark) else zero
    for k in range(count):
        lit += np.int32(shading[k] > zero)
        dim += np.int32((shading[k] > zero) & (v[k] <= dark))
    if count == len(kinds):
        for k in range(count):
            kinds[k] = np.uint8(LIT) if shading[k] > zero else np.uint8(ATTACHED)
    else:
        for k in range(count):
            kinds[index[k]] = LIT if shading[k] > zero else ATTACHED
    return int(lit), int(dim)


@numba.njit(**IN_PLACE, error_model="numpy")
def _kind_of(
    value: np.float32, shading: np.float32, distance: np.float32, limit: np.float32,
    deep: np.float32,
) -> np.uint8:  # fmt: skip
    """Return the kind of a measured sample, without branches: its callers vectorise."""
    zero, half, cut = np.float32(0), np.float32(_SHADOWED), np.float32(_CUT)
    beyond = distance > limit
    shadowed = (value < half * shading) & beyond
    shadowed |= (value < deep * shading) & (distance > cut)
    facing = CAST if shadowed else (_OUTLIER if beyond else LIT)
    averted = ATTACHED if (value <= zero) | (distance <= limit) else _OUTLIER
    return np.uint8(averted if shading <= zero else facing)


@numba.njit(**IN_PLACE, error_model="numpy")
def judged(
    count: int, v: Float32, dark: np.float32, step: int, least: np.float32, scale: np.float32,
    scratch: Float32, index: Int64, kinds: UInt8,
) -> tuple[np.float32, int, int]:  # fmt: skip
    """Write kinds and weights by a scale of the distances; return it and what `all_agree` does."""
    shading, variance, distance, weight = scratch[0], scratch[1], scratch[2], scratch[3]
    zero, one, cut, infinite = np.float32(0), np.float32(1), np.float32(_CUT), np.float32(np.inf)
    # Dark samples count from the second step on, if they agree.
    agreeing = cut * scale if step > 0 else -one
    found = np.int32(0)
    for k in range(count):
        counts = (shading[k] > zero) & ((v[k] > dark) | (distance[k] <= agreeing))
        weight[k] = distance[k] if counts else infinite
        found += np.int32(counts)
    if found > 0:
        # The median of those that count: the others are larger than any limit.
        scale = np.float32(MAD_TO_SIGMA) * ranked(weight, count, found // 2, max(least, scale))
    scale = max(least, scale)
    limit = cut * scale
    # No sample is below the other share, if the law is not that of the noise.
    deep = np.float32(_DEEP) if least == one else -infinite
    if count == len(kinds):
        for k in range(count):
            kinds[k] = _kind_of(v[k], shading[k], distance[k], limit, deep)
    else:
        for k in range(count):
            kinds[index[k]] = _kind_of(v[k], shading[k], distance[k], limit, deep)
    lit, dim = np.int32(0), np.int32(0)
    # In the first step, a dark sample may be in a shadow, if the given solution is wrong.
    darkest = dark if step == 0 else -infinite
    for k in range(count):
        own = np.int32(_kind_of(v[k], shading[k], distance[k], limit, deep) == LIT)
        lit += own
        dim += own & np.int32(v[k] <= darkest)
    for k in range(count):
        own = _kind_of(v[k], shading[k], distance[k], limit, deep) == LIT
        weight[k] = one / variance[k] if own & (v[k] > darkest) else zero
    return scale, int(lit), int(dim)


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=ANY_ORDER)
def normalised_residuals(
    count: int, v: Float32, scratch: Float32, index: Int64, residuals: Float32
) -> float:
    """Write normalised residuals of the samples with a weight; return their sum of squares."""
    shading, distance, weight = scratch[0], scratch[2], scratch[3]
    total, zero, one = 0.0, np.float32(0), np.float32(1)
    if count == len(residuals):
        for k in range(count):
            sign = one if v[k] >= shading[k] else -one
            own = distance[k] * sign
            residuals[k] = own if weight[k] > zero else zero
    else:
        for k in range(count):
            own = distance[k] if weight[k] > zero else zero
            residuals[index[k]] = own if v[k] >= shading[k] else -own
    for i in range(len(residuals)):
        total += float(residuals[i]) * float(residuals[i])
    return total


@numba.njit(**IN_PLACE, error_model="numpy")
def count_kinds(kinds: UInt8, counts: UInt16) -> None:
    """Count the samples that are lit and those in attached shadow."""
    lit, attached = np.int32(0), np.int32(0)
    for k in range(len(kinds)):
        lit += np.int32(kinds[k] == LIT)
        attached += np.int32(kinds[k] == ATTACHED)
    counts[LIT], counts[ATTACHED] = lit, attached
    if lit + attached < len(kinds):
        for k in range(len(kinds)):
            if kinds[k] > ATTACHED:
                counts[kinds[k]] += 1
