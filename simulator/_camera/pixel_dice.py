"""Random numbers for every pixel of a frame, bit-identical to `simulator/gentl/sensor.c`."""

from __future__ import annotations

import math

import numba
import numpy as np

from simulator._dice import GOLDEN, MIX_1, MIX_2

_GOLDEN, _MIX_1, _MIX_2 = (np.uint64(n) for n in (GOLDEN, MIX_1, MIX_2))
_S27, _S30, _S31, _S32, _S33 = (np.uint64(n) for n in (27, 30, 31, 32, 33))
_HALF, _ONE, _MINUS_TWO, _FOUR = (np.float32(n) for n in (0.5, 1, -2, 4))
_TWO_TO_MINUS_31 = np.float32(2.0**-31)
_LN_2 = np.float32(0.6931472)
_ROOT_HALF_BITS = 0x3F3504F3
_LOG = tuple(
    np.float32(n)
    for n in (0.09272214, -0.14118426, 0.14676397, -0.16592856, 0.19985127, -0.25000921, 0.33333409)
)
_SINE = tuple(np.float32(n) for n in (-0.0046021632, 0.07968022, -0.6459635, 1.5707964))
_COSINE = tuple(np.float32(n) for n in (-0.020408256, 0.2535986, -1.233697, 1.0))


@numba.njit(cache=True)
def hashed(state: np.uint64, counter: np.uint64) -> np.uint64:
    """Return the same bits as `simulator._dice.bits`."""
    x = state + (counter + np.uint64(1)) * _GOLDEN
    x = (x ^ (x >> _S30)) * _MIX_1
    x = (x ^ (x >> _S27)) * _MIX_2
    return x ^ (x >> _S31)


@numba.njit(cache=True)
def unit(bits: np.uint64) -> np.float32:
    """Map the highest 31 of 64 bits to a number in (0, 1]."""
    return (np.float32(np.int32(bits >> _S33)) + _HALF) * _TWO_TO_MINUS_31


@numba.njit(cache=True)
def _polynomial(x: np.float32, coefficients: tuple[np.float32, ...]) -> np.float32:
    """Evaluate a polynomial; the coefficient of the highest power is the first."""
    total = coefficients[0]
    for coefficient in coefficients[1:]:
        total = total * x + coefficient
    return total


@numba.njit(cache=True)
def log_of(x: np.float32) -> np.float32:
    """Return the logarithm of a number in (0, 1], to 2e-7.

    This function and `normal_pair` use equiripple polynomials instead of library functions. Their
    results are the same in C to the last bit, and in C they are vectorised over pixels.
    """
    # x = m * 2^e with m from sqrt(1/2) to sqrt(2).
    pattern = np.float32(x).view(np.int32)
    exponent = (pattern - _ROOT_HALF_BITS) >> 23
    f = np.int32(pattern - (exponent << 23)).view(np.float32) - _ONE
    tail = _polynomial(f, _LOG)
    return np.float32(exponent) * _LN_2 + (f - _HALF * f * f + f * f * f * tail)


@numba.njit(cache=True)
def normal_pair(bits: np.uint64) -> tuple[np.float32, np.float32]:
    """Return two independent standard normal numbers (Box and Muller)."""
    radius = np.float32(math.sqrt(_MINUS_TWO * log_of(unit(bits))))
    # Whole quarters of a turn, and the remainder from -1/2 to 1/2.
    quarters = _FOUR * unit(bits << _S32)
    q = np.int32(quarters + _HALF)
    r = quarters - np.float32(q)
    sine, cosine = r * _polynomial(r * r, _SINE), _polynomial(r * r, _COSINE)
    if q & 1:
        sine, cosine = cosine, sine
    return radius * (-cosine if (q + 1) & 2 else cosine), radius * (-sine if q & 2 else sine)
