"""The sensor: convert photons to grey values with the noise and the defects of a real sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from acquisition import NoiseModel
from rig import in_threads, short_repr
from rig.arrays import Float32, UInt16
from rig.kernels import PART
from simulator.noise.dice import GOLDEN, MIX_1, MIX_2, stream
from simulator.scene.lamps import Lamps

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

# Below this mean, Poisson numbers are drawn exactly; above it, by an expansion whose distribution
# function, rounded to whole electrons, is within 0.0015 of the exact one.
EXACT_BELOW_E = np.float32(12.0)

_ZERO, _SIXTH, _SEVENTY_TWO = (np.float32(n) for n in (0, 1 / 6, 72))
_NEXT = np.uint64(1)
# Inversion stops at this length, more than 10 standard deviations above the largest mean.
_RECIPROCAL = np.array([0.0, *(1.0 / n for n in range(1, 48))], np.float32)
_ALIKE = np.zeros((3, 0, 0), np.float32)
_PATTERN_TAG = 0x0F1C  # keeps the fixed pattern apart from every shot of the same seed
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


@dataclass(frozen=True, eq=False)
class FixedPattern:
    """Differences between the pixels of one sensor, the same in every frame.

    Parameters
    ----------
    maps
        ``(3, H, W)`` float32: relative response to light (mean 1), offset in electrons (mean 0),
        and additional dark current of the pixel, electrons per second.
    """

    maps: Float32

    __repr__ = short_repr


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

    Examples
    --------
    >>> from acquisition import NoiseModel
    >>> from simulator.camera import fixed_pattern
    >>> fixed_pattern(NoiseModel(2.0, 5.0, 60.0, 12), (4, 6)) is None  # all pixels are alike
    True
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
    photons: Float32,
    noise: NoiseModel,
    *,
    exposure_us: float = 0.0,
    gain_db: float = 0.0,
    key: tuple[int, ...] | None,
    pattern: FixedPattern | None = None,
    top: int = 0,
) -> UInt16:
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

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import NoiseModel
    >>> from simulator.camera import sensor_image
    >>> noise = NoiseModel(2.0, 5.0, 60.0, 12)
    >>> sensor_image(np.full((4, 6), 1000, np.float32), noise, key=(1,)).shape
    (4, 6)
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
    photons: Float32,
    pattern: Float32,
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
    grey: UInt16,
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
    maps: Float32,
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


@numba.njit(**PART)
def _poisson_by_inversion(mean: np.float32, uniform: np.float32) -> np.float32:
    term = math.exp(-mean)
    total = term
    count = 0
    while uniform > total and count < len(_RECIPROCAL) - 1:
        count += 1
        term *= mean * _RECIPROCAL[count]
        total += term
    return np.float32(count)


@numba.njit(**PART)
def _poisson_by_expansion(mean: np.float32, z: np.float32) -> np.float32:
    """Convert a normal number to a Poisson one by the Cornish-Fisher expansion to third order.

    Mean, variance and skewness are correct. The result is not an integer; the converter rounds it.
    """
    root = math.sqrt(mean)
    square = z * z
    return mean + root * z + (square - _ONE) * _SIXTH + z * (_ONE - square) / (_SEVENTY_TWO * root)


@dataclass(frozen=True)
class ImageFormation:
    """How a virtual camera forms an image from the light that it sees.

    Parameters
    ----------
    noise
        Model of the sensor.
    seed
        Seed of noise, flicker, PWM phase and shake.
    noisy
        If False, frames have no shot noise and no read noise.
    cfa
        Colour filters of the first 2 x 2 pixels of the planes row by row, for example ``RGGB``;
        None for monochrome.
    lamps
        Behaviour of the LEDs over time. Their clock is the sum of all exposure times triggered so
        far, so that the same shots give the same frames at any speed of the host.
    shake_px
        Standard deviation, along each axis, of the image's position in a frame.
    sensor_seed
        Seed of the sensor's fixed pattern, if ``noise`` has one.
    """

    noise: NoiseModel
    seed: int = 0
    noisy: bool = True
    cfa: str | None = None
    lamps: Lamps = Lamps()
    shake_px: float = 0.0
    sensor_seed: int = 0

    __repr__ = short_repr


@numba.njit(cache=True)
def hashed(state: np.uint64, counter: np.uint64) -> np.uint64:
    """Return the same bits as `simulator.noise.dice.bits`.

    All random numbers for pixels are bit-identical to `simulator/gentl/sensor.c`.
    """
    x = state + (counter + np.uint64(1)) * _GOLDEN
    x = (x ^ (x >> _S30)) * _MIX_1
    x = (x ^ (x >> _S27)) * _MIX_2
    return x ^ (x >> _S31)


@numba.njit(cache=True)
def unit(bits: np.uint64) -> np.float32:
    """Map the highest 31 of 64 bits to a number in (0, 1]."""
    return (np.float32(np.int32(bits >> _S33)) + _HALF) * _TWO_TO_MINUS_31


@numba.njit(**PART)
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
    tail: np.float32 = _polynomial(f, _LOG)
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
