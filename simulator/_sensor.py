"""The sensor: electrons in, grey values out, with the noise of a real one."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from acquisition import NoiseModel

# Below this mean, Poisson numbers are drawn exactly; from here on by an expansion whose
# distribution function, rounded to whole electrons, is within 0.0015 of the exact one.
EXACT_BELOW_E = np.float32(12.0)

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11, _S32 = (np.uint64(n) for n in (30, 27, 31, 11, 32))
_LOW = np.uint64(0xFFFFFFFF)
_ZERO, _HALF, _ONE, _MINUS_TWO, _SEVENTY_TWO = (np.float32(n) for n in (0, 0.5, 1, -2, 72))
_SIXTH, _TWO_PI, _TWO_TO_MINUS_32 = (np.float32(n) for n in (1 / 6, 2 * math.pi, 2.0**-32))
# Inversion stops here; 24 electrons more than the largest mean lie 10 standard deviations off.
_RECIPROCAL = np.array([0.0, *(1.0 / n for n in range(1, 48))], np.float32)


def sensor_image(
    electrons: npt.NDArray[np.float32],
    noise: NoiseModel,
    *,
    gain_db: float = 0.0,
    key: tuple[int, ...] | None,
) -> npt.NDArray[np.uint16]:
    """Turn the electrons expected in each pixel into grey values.

    ``DN = round(black level + gain * (Poisson(electrons) + read noise) / electrons_per_dn)``,
    limited to 0 and the white level: the linear camera of EMVA 1288 without dark current. Noise
    comes from a counter-based generator (SplitMix64 of the key and the pixel's index), so it
    depends on neither the order of shots nor the number of threads.

    Parameters
    ----------
    electrons
        ``(H, W)`` float32, expected photo-electrons, not negative.
    noise
        The sensor.
    gain_db
        Analogue gain on top of the sensor's own, decibels (20 dB = tenfold).
    key
        Non-negative whole numbers that name the shot: the same key gives the same noise. None for
        no noise at all (quantisation remains).

    Returns
    -------
    npt.NDArray[np.uint16]
        ``(H, W)``, aligned at the low end.
    """
    dn_per_electron = 10.0 ** (gain_db / 20.0) / noise.electrons_per_dn
    state = np.uint64(0)
    if key is not None:
        state = np.random.SeedSequence(key).generate_state(1, np.uint64)[0]
    grey = np.zeros(electrons.shape, np.uint16)
    _expose(
        np.ascontiguousarray(electrons, np.float32),
        state,
        key is not None,
        np.float32(noise.read_noise_e),
        np.float32(dn_per_electron),
        np.float32(noise.black_level_dn),
        np.float32(noise.white_level_dn),
        grey,
    )
    return grey


@numba.njit(parallel=True, cache=True)
def _expose(
    electrons: npt.NDArray[np.float32],
    state: np.uint64,
    noisy: bool,
    read_noise_e: np.float32,
    dn_per_electron: np.float32,
    black_dn: np.float32,
    white_dn: np.float32,
    grey: npt.NDArray[np.uint16],
) -> None:
    height, width = electrons.shape
    for row in numba.prange(height):
        for column in range(width):
            value = electrons[row, column]
            if noisy:
                counter = np.uint64(2 * (row * width + column))
                bits = _hash(state, counter)
                # Box and Muller: one pair of uniform numbers, two independent normal ones.
                radius = math.sqrt(_MINUS_TWO * math.log(_unit(bits >> _S32)))
                turn = _TWO_PI * _unit(bits & _LOW)
                if value < EXACT_BELOW_E:
                    uniform = _unit(_hash(state, counter + np.uint64(1)) >> _S32)
                    value = _poisson_by_inversion(value, uniform)
                else:
                    value = _poisson_by_expansion(value, np.float32(radius * math.cos(turn)))
                value += read_noise_e * radius * math.sin(turn)
            dn = math.floor(black_dn + dn_per_electron * value + _HALF)
            grey[row, column] = np.uint16(min(max(dn, _ZERO), white_dn))


@numba.njit(cache=True)
def _hash(state: np.uint64, counter: np.uint64) -> np.uint64:
    """SplitMix64 (Steele, Lea and Flood 2014): the counter-th number of a stream."""
    x = state + (counter + np.uint64(1)) * _GOLDEN
    x = (x ^ (x >> _S30)) * _MIX_1
    x = (x ^ (x >> _S27)) * _MIX_2
    return x ^ (x >> _S31)


@numba.njit(cache=True)
def _unit(bits: np.uint64) -> np.float32:
    """Map 32 bits to a number above 0 and at most 1."""
    return (np.float32(bits) + _HALF) * _TWO_TO_MINUS_32


@numba.njit(cache=True)
def _poisson_by_inversion(mean: np.float32, uniform: np.float32) -> np.float32:
    term = math.exp(-mean)
    total = term
    count = 0
    while uniform > total and count < len(_RECIPROCAL) - 1:
        count += 1
        term *= mean * _RECIPROCAL[count]
        total += term
    return np.float32(count)


@numba.njit(cache=True)
def _poisson_by_expansion(mean: np.float32, z: np.float32) -> np.float32:
    """Turn a normal number into a Poisson one by the Cornish-Fisher expansion to third order.

    Mean, variance and skewness are right; the result is not whole, since the converter rounds.
    """
    root = math.sqrt(mean)
    square = z * z
    return mean + root * z + (square - _ONE) * _SIXTH + z * (_ONE - square) / (_SEVENTY_TWO * root)
