"""Normals of random reliefs, with or without the errors of a measurement."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter

from simulator._reliefs.drawn import bodies, cells, strokes, summed, weave
from simulator._reliefs.measured import (
    embossed,
    logarithmic,
    measured_normals,
    random_source,
    ridged,
    rough,
    rounded,
    scaled_to_slope,
    smooth,
)
from simulator._shapes.carved import CrackedLeather, Textile
from simulator._shapes.coin import Coin
from simulator._shapes.surface import Surface

Array = npt.NDArray[np.float64]
Random = np.random.Generator

_STREAM = 19  # keeps these random numbers apart from those of other functions with the same seed
_MARGIN = 8  # the derivatives at the edge are one-sided, and noise is periodic


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
    random = random_source(_STREAM, seed, size)
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
    random = random_source(_STREAM, seed, size)
    normals = measured_normals(random, _relief(random, size + 2 * _MARGIN), faulty=0.5)
    if random.random() < 0.3:
        normals = rounded(normals)
    return _inner(normals).astype(np.float32)


def _relief(random: Random, size: int) -> Array:
    kind = random.integers(10)
    if kind == 9:
        height = bodies(random, size)
    elif kind == 8:
        height = smooth(random, size)
    else:
        height = summed(random, size, _part, 0.3)
    height = gaussian_filter(height, logarithmic(random, 0.3, 3.0), mode="reflect")
    if kind == 9:  # bodies have a natural height
        return np.asarray(random.uniform(0.5, 1.2) * height)
    return scaled_to_slope(random, height, 2.0, 28.0)


def _part(random: Random, size: int) -> Array:
    parts = (cells, weave, strokes, embossed, ridged, rough, material)
    return parts[random.integers(len(parts))](random, size)


def _inner(image: Array) -> Array:
    return image[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN]


def material(random: Random, size: int) -> Array:
    """Return cloth, leather or a part of a coin.

    `LizardScales` and `WoodCarving` are left out: they are for judging what was trained on others.

    Parameters
    ----------
    random
        Source of random numbers.
    size
        Side of the square in pixels.

    Returns
    -------
    Array
        ``(size, size)`` heights in pixels.
    """
    seed = int(random.integers(2**31))
    surface: Surface
    kind = random.integers(3)
    if kind == 0:
        surface = Textile(size, seed=seed, yarn_mm=random.uniform(8, 40))
    elif kind == 1:
        surface = CrackedLeather(size, seed=seed, plate_mm=random.uniform(16, 80))
    else:
        radius = random.uniform(0.5, 1.5) * size
        surface = Coin(radius, dome_mm=random.uniform(0.01, 0.1) * radius, seed=seed)
    y, x = np.mgrid[:size, :size] - size / 2 + random.uniform(-0.3, 0.3, (2, 1, 1)) * size
    angle = random.uniform(0, 2 * math.pi)
    c, s = math.cos(angle), math.sin(angle)
    return surface.evaluate(c * x + s * y, c * y - s * x)[0]
