"""What random surfaces have in common: their slope, and the errors of a measurement."""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import gaussian_filter

from acquisition import DataError
from rig.arrays import Float64

Random = np.random.Generator

_LEAST, _MOST = 16, 4096
_TILT = 0.25  # standard deviation of the slopes of a whole map: 14 degrees on average
# Amplitude of waves that are longer than the longest one, relative to the power law.
_LONG_WAVES = 0.05


def random_source(stream: int, seed: int, size: int) -> Random:
    """Return the source of random numbers of one function and seed.

    Parameters
    ----------
    stream
        Keeps these random numbers apart from those of other functions with the same seed.
    seed, size
        Seed, and side of the square in pixels.

    Raises
    ------
    DataError
        If the size or the seed is out of range.
    """
    if not 0 <= seed < 2**63:
        raise DataError(f"a seed of {seed} is out of range: use 0 to 2^63 - 1")
    if not _LEAST <= size <= _MOST:
        raise DataError(f"a size of {size} pixels is out of range: use {_LEAST} to {_MOST}")
    return np.random.default_rng([stream, seed])


def errors(random: Random, size: int) -> Float64:
    """Return errors of n_x and n_y relative to the mean slope, ``(size, size, 2)``."""
    strength, power = logarithmic(random, 0.05, 1.0), random.uniform(0, 1.6)
    texture = np.ones((size, size))
    if random.random() < 0.6:
        texture = np.exp(random.uniform(0, 1.2) * power_noise(random, size, 1.5))
    noise = [
        gaussian_filter(power_noise(random, size, power), random.uniform(0, 0.8)) for _ in range(2)
    ]
    return np.asarray(strength * np.dstack(noise) * (texture / texture.mean())[..., None])


def measured_normals(random: Random, height: Float64, faulty: float) -> Float64:
    """Return the normals of a surface that is tilted at random, some with errors.

    Parameters
    ----------
    random
        Source of random numbers.
    height
        ``(size, size)`` heights in pixels.
    faulty
        Share of the maps that contain errors, 0 to 1.
    """
    down, right = np.gradient(height)
    tilt = random.normal(0, _TILT, 2)
    normals = unit(np.dstack([tilt[0] - right, tilt[1] + down, np.ones(height.shape)]))
    if random.random() < faulty:
        normals[..., :2] += float(np.hypot(right, down).mean()) * errors(random, len(height))
        normals = unit(normals)
    return normals


def rounded(normals: Float64) -> Float64:
    """Return normals after storage in 8 bits."""
    return unit(np.round(127.5 * normals) / 127.5)


def scaled_to_slope(random: Random, height: Float64, low_deg: float, high_deg: float) -> Float64:
    """Return a surface with a random mean slope, evenly distributed on a logarithmic scale."""
    wanted = math.tan(math.radians(logarithmic(random, low_deg, high_deg)))
    return np.asarray(wanted / slope(height) * height)


def slope(height: Float64) -> float:
    """Return the mean slope of a surface."""
    return float(np.hypot(*np.gradient(height)).mean()) + 1e-12


def logarithmic(random: Random, low: float, high: float) -> float:
    """Return a random number, evenly distributed on a logarithmic scale."""
    return math.exp(random.uniform(math.log(low), math.log(high)))


def unit(vectors: Float64) -> Float64:
    """Return vectors of unit length."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def turned(x: Float64, y: Float64, angle: float) -> tuple[Float64, Float64]:
    """Return positions in axes that are turned counterclockwise by an angle in radians."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return cosine * x + sine * y, cosine * y - sine * x


def power_noise(
    random: Random, size: int, power: float, *, longest: float = math.inf, stretch: float = 1.0
) -> Float64:
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
    waves = np.asarray(np.fft.fftfreq(size), np.float64)
    x, y = waves[None, :], waves[:, None]
    along, across = turned(x, y, random.uniform(0, math.pi))
    frequency = np.hypot(stretch * along, across)
    frequency[0, 0] = 1
    amplitude = frequency**-power
    amplitude[np.hypot(x, y) < 1 / longest] *= _LONG_WAVES
    amplitude[0, 0] = 0
    spectrum = np.fft.fft2(random.standard_normal((size, size)))
    noise = np.fft.ifft2(amplitude * spectrum).real
    return np.asarray(noise / noise.std())


def rough(random: Random, size: int) -> Float64:
    """Return isotropic or brushed noise, with or without long waves."""
    return power_noise(
        random,
        size,
        random.uniform(1.0, 2.6),
        longest=random.choice([math.inf, 100.0, 33.0]),
        stretch=random.choice([1.0, 1.0, 1.0, 3.0, 6.0]),
    )


def smooth(random: Random, size: int) -> Float64:
    """Return long waves, without structure of a few pixels."""
    return power_noise(random, size, random.uniform(2.6, 3.5))


def ridged(random: Random, size: int) -> Float64:
    """Return a mountain range: sharp ridges where noise crosses zero."""
    return -np.abs(power_noise(random, size, random.uniform(1.4, 2.4)))


def embossed(random: Random, size: int) -> Float64:
    """Return irregular plates on two levels, with slopes between them."""
    noise = power_noise(random, size, random.uniform(1.5, 2.6))
    return np.tanh(random.uniform(1, 12) * noise)
