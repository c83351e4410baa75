"""The sensor: convert photons to grey values with the noise and the defects of a real sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from acquisition import NoiseModel
from rig import in_threads
from simulator._camera.pixel_dice import hashed, log_of, normal_pair, unit
from simulator._dice import stream

# Compiled in: simulator/_camera/pixel_dice.py 97f2401bf4d8

# Below this mean, Poisson numbers are drawn exactly; above it, by an expansion whose distribution
# function, rounded to whole electrons, is within 0.0015 of the exact one.
EXACT_BELOW_E = np.float32(12.0)

_ZERO, _HALF, _ONE, _SIXTH, _SEVENTY_TWO = (np.float32(n) for n in (0, 0.5, 1, 1 / 6, 72))
_NEXT, _S32 = np.uint64(1), np.uint64(32)
# Inversion stops at this length, more than 10 standard deviations above the largest mean.
_RECIPROCAL = np.array([0.0, *(1.0 / n for n in range(1, 48))], np.float32)
_ALIKE = np.zeros((3, 0, 0), np.float32)
_PATTERN_TAG = 0x0F1C  # keeps the fixed pattern apart from every shot of the same seed


@dataclass(frozen=True, eq=False)
class FixedPattern:
    """Differences between the pixels of one sensor, the same in every frame.

    Parameters
    ----------
    maps
        ``(3, H, W)`` float32: relative response to light (mean 1), offset in electrons (mean 0),
        and additional dark current of the pixel, electrons per second.
    """

    maps: npt.NDArray[np.float32]


def pixel_format(cfa: str | None, depth: int) -> str:
    """Return the GenICam pixel format of unpacked samples of ``depth`` bits."""
    return f"Mono{depth}" if cfa is None else f"Bayer{cfa[:2]}{depth}"


def fixed_pattern(
    noise: NoiseModel, size: tuple[int, int], *, seed: int = 0, top: int = 0
) -> FixedPattern | None:
    """Draw the fixed pattern of a sensor.

    Response and offset are normally distributed; hot pixels are at random positions and their
    currents are exponentially distributed.

    Parameters
    ----------
    noise
        Model with the strength of the pattern: ``prnu``, ``dsnu_e``, ``hot_pixel_fraction`` and
        ``hot_pixel_e_per_s``.
    size
        (H, W).
    seed
        Seed that identifies the sensor, like a serial number; not the shot.
    top
        Row of the sensor in which the pattern begins.

    Returns
    -------
    FixedPattern or None
        None if all pixels are alike.
    """
    hot = noise.hot_pixel_fraction * noise.hot_pixel_e_per_s
    if not (noise.prnu or noise.dsnu_e or hot):
        return None
    maps = np.zeros((3, *size), np.float32)
    in_threads(
        _draw_pattern,
        size[0],
        np.uint64(stream(seed, _PATTERN_TAG)),
        np.float32(noise.prnu),
        np.float32(noise.dsnu_e),
        noise.hot_pixel_fraction,
        np.float32(noise.hot_pixel_e_per_s),
        top,
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
    top: int = 0,
) -> npt.NDArray[np.uint16]:
    """Convert the expected photons of each pixel to grey values with the linear EMVA 1288 model.

    With response r, offset o and dark current d of the pixel::

        charge = min(Poisson(quantum efficiency * r * photons + d * exposure), full well)
        DN = round(black level + gain * (charge + o + read noise) / electrons_per_dn)

    clipped to the range of the converter. The noise is from a counter-based generator (SplitMix64
    of the key and the pixel's index), so it depends neither on the order of shots nor on the number
    of threads.

    Parameters
    ----------
    photons
        ``(H, W)`` float32, expected number during the exposure, not negative. With a quantum
        efficiency of 1, these are electrons, as in the planes of the renderer.
    noise
        Model of the sensor.
    exposure_us
        Exposure time, used only for the dark current.
    gain_db
        Analogue gain in addition to the sensor's own, decibels (20 dB = tenfold).
    key
        Non-negative integers that identify the shot: the same key gives the same noise. None for
        no temporal noise; quantisation and fixed pattern remain.
    pattern
        Pattern of the same size from `fixed_pattern`; None if all pixels are alike.
    top
        Row of the sensor in which ``photons`` begin.

    Returns
    -------
    npt.NDArray[np.uint16]
        ``(H, W)`` grey values in the least significant bits.
    """
    dn_per_electron = 10.0 ** (gain_db / 20.0) / noise.electrons_per_dn
    state = np.uint64(0 if key is None else stream(*key))
    exposure_s = exposure_us / 1e6
    grey = np.zeros(photons.shape, np.uint16)
    in_threads(
        _expose,
        len(grey),
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
        top,
        grey,
    )
    return grey


@numba.njit(nogil=True, cache=True)
def _expose(
    first: int,
    last: int,
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
    top: int,
    grey: npt.NDArray[np.uint16],
) -> None:
    width = photons.shape[1]
    alike = pattern.shape[1] == 0
    for row in range(first, last):
        for column in range(width):
            value = efficiency * photons[row, column] + dark_e
            offset = _ZERO
            if not alike:
                value = efficiency * pattern[0, row, column] * photons[row, column] + dark_e
                value += pattern[2, row, column] * exposure_s
                offset = pattern[1, row, column]
            if noisy:
                counter = np.uint64(2 * ((top + row) * width + column))
                shot, read = normal_pair(hashed(state, counter))
                offset += read_noise_e * read
                if value < EXACT_BELOW_E:
                    uniform = unit(hashed(state, counter + _NEXT))
                    value = _poisson_by_inversion(value, uniform)
                else:
                    value = _poisson_by_expansion(value, shot)
            value = min(value, full_well_e) + offset
            dn = math.floor(black_dn + dn_per_electron * value + _HALF)
            grey[row, column] = np.uint16(min(max(dn, _ZERO), end_dn))


@numba.njit(nogil=True, cache=True)
def _draw_pattern(
    first: int,
    last: int,
    state: np.uint64,
    prnu: np.float32,
    dsnu_e: np.float32,
    hot_fraction: float,
    hot_e_per_s: np.float32,
    top: int,
    maps: npt.NDArray[np.float32],
) -> None:
    width = maps.shape[2]
    for row in range(first, last):
        for column in range(width):
            counter = np.uint64(2 * ((top + row) * width + column))
            response, offset = normal_pair(hashed(state, counter))
            maps[0, row, column] = max(_ONE + prnu * response, _ZERO)
            maps[1, row, column] = dsnu_e * offset
            bits = hashed(state, counter + _NEXT)
            if unit(bits) <= hot_fraction:
                maps[2, row, column] = -hot_e_per_s * log_of(unit(bits << _S32))


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
    """Convert a normal number to a Poisson one by the Cornish-Fisher expansion to third order.

    Mean, variance and skewness are correct. The result is not an integer; the converter rounds it.
    """
    root = math.sqrt(mean)
    square = z * z
    return mean + root * z + (square - _ONE) * _SIXTH + z * (_ONE - square) / (_SEVENTY_TWO * root)
