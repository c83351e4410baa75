"""Order statistics of the samples of one pixel, compiled."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from processing._stereo.pixel_algebra import IN_PLACE

# Compiled in: processing/_stereo/pixel_algebra.py d36a51d0daee

Float = npt.NDArray[np.float32]

# Passes that locate a rank, each in a quarter of the range before: to 1 part in 64, a tenth of the
# noise of a median.
_PASSES = 3
# 1 / (0.75 quantile of the normal distribution): converts the median of |r| into a standard
# deviation.
MAD_TO_SIGMA = 1.4826


@numba.njit(**IN_PLACE)
def count_up_to(values: Float, count: int, limit: np.float32) -> int:
    """Return how many of the first ``count`` values do not exceed a limit."""
    found = np.int32(0)
    for k in range(count):
        found += np.int32(values[k] <= limit)
    return int(found)


@numba.njit(**IN_PLACE)
def _count_up_to_three(
    values: Float, count: int, a: np.float32, b: np.float32, c: np.float32
) -> tuple[int, int, int]:
    """Return how many of the first ``count`` values do not exceed each of three limits."""
    below_a = below_b = below_c = np.int32(0)
    for k in range(count):
        below_a += np.int32(values[k] <= a)
        below_b += np.int32(values[k] <= b)
        below_c += np.int32(values[k] <= c)
    return int(below_a), int(below_b), int(below_c)


@numba.njit(**IN_PLACE)
def ranked(values: Float, count: int, rank: int, guess: np.float32) -> np.float32:
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
