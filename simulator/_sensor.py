"""The sensor: photons in, grey values out, with the noise and the faults of a real one."""

from __future__ import annotations

import math
from dataclasses import dataclass

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
_ALIKE = np.zeros((3, 0, 0), np.float32)
_PATTERN_TAG = 0x0F1C  # keeps the fixed pattern apart from every shot of the same seed


@dataclass(frozen=True, eq=False)
class FixedPattern:
    """How the pixels of one sensor differ from each other, the same in every frame.

    Parameters
    ----------
    maps
        ``(3, H, W)`` float32: relative response to light (mean 1), offset in electrons (mean 0),
        and what the pixel has more of dark current, electrons per second.
    """

    maps: npt.NDArray[np.float32]


def fixed_pattern(
    noise: NoiseModel, size: tuple[int, int], *, seed: int = 0
) -> FixedPattern | None:
    """Draw the fixed pattern of a sensor.

    Response and offset are normal; hot pixels lie anywhere and their currents are exponentially
    distributed.

    Parameters
    ----------
    noise
        How strong: ``prnu``, ``dsnu_e``, ``hot_pixel_fraction`` and ``hot_pixel_e_per_s``.
    size
        (H, W).
    seed
        Names the sensor, as a serial number does; not the shot.

    Returns
    -------
    FixedPattern or None
        None for a sensor whose pixels are all alike.
    """
    hot = noise.hot_pixel_fraction * noise.hot_pixel_e_per_s
    if not (noise.prnu or noise.dsnu_e or hot):
        return None
    maps = np.zeros((3, *size), np.float32)
    _draw_pattern(
        np.random.SeedSequence((seed, _PATTERN_TAG)).generate_state(1, np.uint64)[0],
        np.float32(noise.prnu),
        np.float32(noise.dsnu_e),
        noise.hot_pixel_fraction,
        np.float32(noise.hot_pixel_e_per_s),
        maps,
    )
    return FixedPattern(maps)


def sensor_image(
    photons: npt.NDArray[np.float32],
    noise: NoiseModel,
    *,
    exposure_us: float = 0.0,
    gain_db: float = 0.0,
    key: tuple[int, ...] | None,
    pattern: FixedPattern | None = None,
) -> npt.NDArray[np.uint16]:
    """Turn the photons expected on each pixel into grey values, after the linear EMVA 1288 camera.

    With response r, offset o and dark current d of the pixel::

        charge = min(Poisson(quantum efficiency * r * photons + d * exposure), full well)
        DN = round(black level + gain * (charge + o + read noise) / electrons_per_dn)

    limited to 0 and the end of the converter. Noise comes from a counter-based generator
    (SplitMix64 of the key and the pixel's index), so it depends on neither the order of shots nor
    the number of threads.

    Parameters
    ----------
    photons
        ``(H, W)`` float32, expected during the exposure, not negative. A quantum efficiency of 1
        makes them electrons: so are a renderer's planes meant.
    noise
        The sensor.
    exposure_us
        Only for the dark current.
    gain_db
        Analogue gain on top of the sensor's own, decibels (20 dB = tenfold).
    key
        Non-negative whole numbers that name the shot: the same key gives the same noise. None for
        no temporal noise at all; quantisation and fixed pattern remain.
    pattern
        From `fixed_pattern`, of the same size; None where all pixels are alike.

    Returns
    -------
    npt.NDArray[np.uint16]
        ``(H, W)``, aligned at the low end.
    """
    dn_per_electron = 10.0 ** (gain_db / 20.0) / noise.electrons_per_dn
    state = np.uint64(0)
    if key is not None:
        state = np.random.SeedSequence(key).generate_state(1, np.uint64)[0]
    exposure_s = exposure_us / 1e6
    grey = np.zeros(photons.shape, np.uint16)
    _expose(
        np.ascontiguousarray(photons, np.float32),
        _ALIKE if pattern is None else pattern.maps,
        state,
        key is not None,
        np.float32(noise.quantum_efficiency),
        np.float32(noise.dark_current_e_per_s * exposure_s),
        np.float32(exposure_s),
        np.float32(math.inf if noise.full_well_e is None else noise.full_well_e),
        np.float32(noise.read_noise_e),
        np.float32(dn_per_electron),
        np.float32(noise.black_level_dn),
        np.float32(noise.converter_end_dn),
        grey,
    )
    return grey


@numba.njit(parallel=True, cache=True)
def _expose(
    photons: npt.NDArray[np.float32],
    pattern: npt.NDArray[np.float32],
    state: np.uint64,
    noisy: bool,
    efficiency: np.float32,
    dark_e: np.float32,
    exposure_s: np.float32,
    full_well_e: np.float32,
    read_noise_e: np.float32,
    dn_per_electron: np.float32,
    black_dn: np.float32,
    end_dn: np.float32,
    grey: npt.NDArray[np.uint16],
) -> None:
    height, width = photons.shape
    alike = pattern.shape[1] == 0
    for row in numba.prange(height):
        for column in range(width):
            value = efficiency * photons[row, column] + dark_e
            offset = _ZERO
            if not alike:
                value = efficiency * pattern[0, row, column] * photons[row, column] + dark_e
                value += pattern[2, row, column] * exposure_s
                offset = pattern[1, row, column]
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
                value = min(value, full_well_e) + offset + read_noise_e * radius * math.sin(turn)
            else:
                value = min(value, full_well_e) + offset
            dn = math.floor(black_dn + dn_per_electron * value + _HALF)
            grey[row, column] = np.uint16(min(max(dn, _ZERO), end_dn))


@numba.njit(parallel=True, cache=True)
def _draw_pattern(
    state: np.uint64,
    prnu: np.float32,
    dsnu_e: np.float32,
    hot_fraction: float,
    hot_e_per_s: np.float32,
    maps: npt.NDArray[np.float32],
) -> None:
    height, width = maps.shape[1:]
    for row in numba.prange(height):
        for column in range(width):
            counter = np.uint64(2 * (row * width + column))
            bits = _hash(state, counter)
            radius = math.sqrt(_MINUS_TWO * math.log(_unit(bits >> _S32)))
            turn = _TWO_PI * _unit(bits & _LOW)
            maps[0, row, column] = max(_ONE + prnu * radius * math.cos(turn), _ZERO)
            maps[1, row, column] = dsnu_e * radius * math.sin(turn)
            bits = _hash(state, counter + np.uint64(1))
            if _unit(bits >> _S32) <= hot_fraction:
                maps[2, row, column] = -hot_e_per_s * math.log(_unit(bits & _LOW))


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
