"""Reliefs from noise whose spectrum is a power law: rough, ridged and embossed surfaces."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Random = np.random.Generator

# Amplitude of waves that are longer than the longest one, relative to the power law.
_LONG_WAVES = 0.05


def power_noise(
    random: Random, size: int, power: float, *, longest: float = math.inf, stretch: float = 1.0
) -> Array:
    """Return periodic noise whose amplitude is proportional to frequency^-power.

    Parameters
    ----------
    random
        Source of random numbers.
    size
        Side of the square in pixels.
    power
        0 for white noise; the larger, the smoother.
    longest
        Wavelength in pixels above which there is almost none.
    stretch
        How many times longer the waves are along a random direction than across.

    Returns
    -------
    Array
        ``(size, size)`` heights of mean 0 and standard deviation 1.
    """
    x, y = np.fft.fftfreq(size)[None, :], np.fft.fftfreq(size)[:, None]
    angle = random.uniform(0, math.pi)
    along, across = (
        math.cos(angle) * x + math.sin(angle) * y,
        math.cos(angle) * y - math.sin(angle) * x,
    )
    frequency = np.hypot(stretch * along, across)
    frequency[0, 0] = 1
    amplitude = frequency**-power
    amplitude[np.hypot(x, y) < 1 / longest] *= _LONG_WAVES
    amplitude[0, 0] = 0
    waves = np.fft.fft2(random.standard_normal((size, size)))
    noise = np.fft.ifft2(amplitude * waves).real
    return np.asarray(noise / noise.std())


def rough(random: Random, size: int) -> Array:
    """Return isotropic or brushed noise, with or without long waves."""
    return power_noise(
        random,
        size,
        random.uniform(1.0, 2.6),
        longest=random.choice([math.inf, 100.0, 33.0]),
        stretch=random.choice([1.0, 1.0, 1.0, 3.0, 6.0]),
    )


def smooth(random: Random, size: int) -> Array:
    """Return long waves, without structure of a few pixels."""
    return power_noise(random, size, random.uniform(2.6, 3.5))


def ridged(random: Random, size: int) -> Array:
    """Return a mountain range: sharp ridges where noise crosses zero."""
    return -np.abs(power_noise(random, size, random.uniform(1.4, 2.4)))


def embossed(random: Random, size: int) -> Array:
    """Return irregular plates on two levels, with slopes between them."""
    noise = power_noise(random, size, random.uniform(1.5, 2.6))
    return np.tanh(random.uniform(1, 12) * noise)
