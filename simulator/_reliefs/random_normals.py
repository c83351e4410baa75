"""Normals of random reliefs, with or without the errors of a measurement."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter

from simulator._errors import DataError
from simulator._reliefs.cells import cells
from simulator._reliefs.drawn import bodies, strokes, weave
from simulator._reliefs.materials import material
from simulator._reliefs.noise import embossed, power_noise, ridged, rough, smooth

Array = npt.NDArray[np.float64]
Random = np.random.Generator

_PARTS = (cells, weave, strokes, embossed, ridged, rough, material)
_STREAM = 19  # keeps these random numbers apart from those of other functions with the same seed
_MARGIN = 8  # the derivatives at the edge are one-sided, and noise is periodic
_LEAST, _MOST = 16, 4096


def random_relief(seed: int, size: int = 240) -> Array:
    """Return a random relief in pixels: one of many kinds of surfaces, as training data.

    One in ten consists of bodies that hide each other, one in ten of long waves. The others are
    sums of one to three of these: cells (cracks, pebbles, plates, bricks), weaves, strokes, plates
    on two levels, ridges, rough or brushed surfaces, and the simulator's cloth, leather and coins.
    All are blurred by 0.3 to 3 pixels. Their mean slope is 2 to 28 degrees, distributed evenly on a
    logarithmic scale.

    Parameters
    ----------
    seed
        Fixes everything, 0 to 2^63 - 1.
    size
        Side of the square in pixels, 16 to 4096.

    Returns
    -------
    Array
        ``(size, size)`` float64 heights in pixels.

    Raises
    ------
    DataError
        If the size or the seed is out of range.

    Examples
    --------
    >>> import simulator
    >>> simulator.random_relief(3, size=64).shape
    (64, 64)
    """
    random = _random(seed, size)
    return _inner(_relief(random, size + 2 * _MARGIN))


def random_normals(seed: int, size: int = 240) -> npt.NDArray[np.float32]:
    """Return the normals of a random relief as a measurement gives them, as training data.

    The relief is that of `random_relief`, tilted by 14 degrees on average. Half of the maps contain
    errors that belong to no surface: noise of photometric stereo, correlated over some pixels, of
    0.05 to 1 times the mean slope, and stronger where a random texture is bright. Three in ten are
    rounded to 8 bits.

    Parameters
    ----------
    seed, size
        As for `random_relief`.

    Returns
    -------
    NDArray[np.float32]
        ``(size, size, 3)`` unit vectors in the house frame.

    Raises
    ------
    DataError
        If the size or the seed is out of range.

    Examples
    --------
    >>> import simulator
    >>> simulator.random_normals(3, size=64).shape
    (64, 64, 3)
    """
    random = _random(seed, size)
    size += 2 * _MARGIN
    height = _relief(random, size)
    down, right = np.gradient(height)
    tilt = random.normal(0, 0.25, 2)
    normals = _unit(np.dstack([tilt[0] - right, tilt[1] + down, np.ones((size, size))]))
    if random.random() < 0.5:
        slope = float(np.hypot(right, down).mean())
        normals[..., :2] += slope * _errors(random, size)
        normals = _unit(normals)
    if random.random() < 0.3:
        normals = _unit(np.round(127.5 * normals) / 127.5)
    return _inner(normals).astype(np.float32)


def _random(seed: int, size: int) -> Random:
    if not 0 <= seed < 2**63:
        raise DataError(f"a seed of {seed} is out of range: use 0 to 2^63 - 1")
    if not _LEAST <= size <= _MOST:
        raise DataError(f"a size of {size} pixels is out of range: use {_LEAST} to {_MOST}")
    return np.random.default_rng([_STREAM, seed])


def _relief(random: Random, size: int) -> Array:
    kind = random.integers(10)
    if kind == 9:
        height = bodies(random, size)
    elif kind == 8:
        height = smooth(random, size)
    else:
        height = np.zeros((size, size))
        for _ in range(random.integers(1, 4)):
            part = _PARTS[random.integers(len(_PARTS))](random, size)
            height += random.uniform(0.2, 1) / _slope(gaussian_filter(part, 0.7)) * part
        if random.random() < 0.3:
            height += random.uniform(0.1, 0.6) * bodies(random, size)
    height = gaussian_filter(height, _logarithmic(random, 0.3, 3.0), mode="reflect")
    if kind == 9:  # bodies have a natural height
        return np.asarray(random.uniform(0.5, 1.2) * height)
    wanted = math.tan(math.radians(_logarithmic(random, 2.0, 28.0)))
    return np.asarray(wanted / _slope(height) * height)


def _errors(random: Random, size: int) -> Array:
    """Return errors of n_x and n_y relative to the mean slope, ``(size, size, 2)``."""
    strength, power = _logarithmic(random, 0.05, 1.0), random.uniform(0, 1.6)
    texture = np.ones((size, size))
    if random.random() < 0.6:
        texture = np.exp(random.uniform(0, 1.2) * power_noise(random, size, 1.5))
    noise = [
        gaussian_filter(power_noise(random, size, power), random.uniform(0, 0.8)) for _ in range(2)
    ]
    return np.asarray(strength * np.dstack(noise) * (texture / texture.mean())[..., None])


def _slope(height: Array) -> float:
    return float(np.hypot(*np.gradient(height)).mean()) + 1e-12


def _logarithmic(random: Random, low: float, high: float) -> float:
    return math.exp(random.uniform(math.log(low), math.log(high)))


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _inner(image: Array) -> Array:
    return image[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN]
