"""Normals of random reliefs, with or without the errors of a measurement."""

from __future__ import annotations

import math

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from rig.arrays import Float32, Float64
from simulator.reliefs.designs import bodies, cells, strokes, summed, weave
from simulator.reliefs.measurement import (
    embossed,
    logarithmic,
    measured_normals,
    power_noise,
    random_source,
    ridged,
    rough,
    rounded,
    scaled_to_slope,
    slope,
    smooth,
    turned,
    unit,
)
from simulator.shapes.carved_surfaces import CrackedLeather, Textile
from simulator.shapes.coin import Coin
from simulator.shapes.surface import Surface

Random = np.random.Generator

_STREAM = 19  # keeps these random numbers apart from those of other functions with the same seed
_MARGIN = 8  # the derivatives at the edge are one-sided, and noise is periodic
_RUGGED_STREAM = 77
_SHORTEST_PX = 2.5
_LARGEST_GAIN = 6.0


def random_relief(seed: int, size: int = 240) -> Float64:
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
    >>> simulator.reliefs.random_relief(3, size=64).shape
    (64, 64)
    """
    random = random_source(_STREAM, seed, size)
    return _inner(_relief(random, size + 2 * _MARGIN))


def random_normals(seed: int, size: int = 240) -> Float32:
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


def _relief(random: Random, size: int) -> Float64:
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


def _part(random: Random, size: int) -> Float64:
    parts = (cells, weave, strokes, embossed, ridged, rough, material)
    return parts[random.integers(len(parts))](random, size)


def _inner(image: Float64) -> Float64:
    return image[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN]


def material(random: Random, size: int) -> Float64:
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
    return surface.evaluate(*turned(x, y, random.uniform(0, 2 * math.pi)))[0]


def rugged_normals(seed: int, size: int = 240) -> Float32:
    """Return the normals of a rugged surface as a measurement gives them, as training data.

    One in five is a smooth object with fine detail in some places, and one in ten consists of
    leaves that hide each other. The others are sums of one to three of these: crusts (waves of all
    lengths that are stronger on the longer ones, with ridges or creases), chipped stone, and
    worn surfaces, most of them warped. All are blurred by 0.3 to 1.6 pixels. Their mean slope is 6
    to 42 degrees, and they are tilted by 14 degrees on average. Four in ten contain the errors of
    `random_normals`; three in ten are rounded to 8 bits, and two in ten were stored as JPEG.

    Parameters
    ----------
    seed
        Fixes everything, 0 to 2^63 - 1.
    size
        Side of the square in pixels, 16 to 4096.

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
    >>> simulator.reliefs.rugged_normals(3, size=64).shape
    (64, 64, 3)
    """
    random = random_source(_RUGGED_STREAM, seed, size)
    normals = measured_normals(random, _rugged_relief(random, size + 2 * _MARGIN), faulty=0.4)
    stored = random.random()
    if stored < 0.3:
        normals = rounded(normals)
    elif stored < 0.5:
        normals = _compressed(random, normals)
    return _inner(normals).astype(np.float32)


def _rugged_relief(random: Random, size: int) -> Float64:
    kind = random.integers(10)
    if kind >= 8:
        height = patchy(random, size)
    elif kind == 7:
        height = foliage(random, size)
    else:
        height = summed(random, size, _rugged_part, 0.2)
    height = gaussian_filter(height, logarithmic(random, 0.3, 1.6), mode="reflect")
    return scaled_to_slope(random, height, 6.0, 42.0)


def _rugged_part(random: Random, size: int) -> Float64:
    parts = (crusted, crusted, faceted, worn)
    part = parts[random.integers(len(parts))](random, size)
    return warped(random, part) if random.random() < 0.6 else part


def _compressed(random: Random, normals: Float64) -> Float64:
    """Return normals after storage as a JPEG of quality 75 to 98, with all colours or half."""
    image = np.round(127.5 * (normals[..., ::-1] + 1)).clip(0, 255).astype(np.uint8)
    quality = int(random.integers(75, 99))
    factors = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420
    colours = factors[int(random.random() >= 0.5)]
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, colours]
    stored = cv2.imencode(".jpg", image, options)[1]
    read = cv2.imdecode(stored, cv2.IMREAD_COLOR)
    return unit(np.asarray(read, np.float64)[..., ::-1] / 127.5 - 1)


def crusted(random: Random, size: int) -> Float64:
    """Return waves of all lengths, each stronger where the longer ones are high (multifractal).

    The waves are round, ridges, grooves, or bodies that meet at creases. From F. K. Musgrave,
    *Methods for realistic landscape imaging*, 1993.
    """
    height, gain = np.zeros((size, size)), np.ones((size, size))
    power, depth = random.uniform(0.6, 1.3), random.uniform(0, 0.9)
    wave, kind = float(random.choice([16, 32, 64, 128])), random.integers(4)
    while wave >= _SHORTEST_PX:
        waves = _waves(random, size, wave)
        if kind == 0:
            waves = -np.abs(waves)
        elif kind == 1:
            waves = np.abs(waves)
        elif kind == 2:
            waves = np.maximum(waves, _waves(random, size, wave))
        waves -= waves.mean()
        height += wave**power * gain * waves
        gain *= np.exp(depth * np.clip(waves, -2, 2) - depth**2 / 2)
        gain = np.minimum(gain, _LARGEST_GAIN)
        wave /= 2
    return height


def faceted(random: Random, size: int) -> Float64:
    """Return chipped stone: tilted planes that meet at edges, small ones on large ones."""
    height = np.zeros((size, size))
    places = np.mgrid[:size, :size].transpose(1, 2, 0).reshape(-1, 2)
    side = logarithmic(random, 5, 40)
    for _ in range(random.integers(1, 4)):
        points = random.uniform(-side, size + side, (max(8, int((size / side) ** 2)), 2))
        tilts = random.normal(0, 1, points.shape)
        rises = random.normal(0, 0.4 * side, len(points))
        near = np.asarray(cKDTree(points).query(places, k=4)[1], np.intp)
        planes = rises[near] + ((places[:, None] - points[near]) * tilts[near]).sum(axis=2)
        ends = planes.max(axis=1) if random.random() < 0.5 else planes.min(axis=1)
        height += random.uniform(0.3, 1) * ends.reshape(size, size)
        side /= 2.5
        if side < 4:
            break
    return height


def worn(random: Random, size: int) -> Float64:
    """Return noise from which a round tool has removed ridges or filled grooves."""
    stretch = float(random.choice([1, 1, 2, 4]))
    height = power_noise(random, size, random.uniform(1.2, 2.2), stretch=stretch).astype(np.float32)
    kinds = (cv2.MORPH_ERODE, cv2.MORPH_DILATE, cv2.MORPH_OPEN, cv2.MORPH_CLOSE)
    for _ in range(random.integers(1, 3)):
        side = 2 * int(random.integers(1, 6)) + 1
        tool = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
        height = np.asarray(cv2.morphologyEx(height, kinds[random.integers(4)], tool), np.float32)
    if random.random() < 0.5:
        height = np.asarray(cv2.medianBlur(height, 5), np.float32)
    return height.astype(np.float64)


def foliage(random: Random, size: int) -> Float64:
    """Return folded leaves that hide parts of each other."""
    height = 4 * smooth(random, size)
    length = logarithmic(random, 5, 40)
    for _ in range(min(300, int(random.uniform(0.5, 2) * (size / length) ** 2))):
        along = length * random.uniform(0.6, 1.4)
        across = along * random.uniform(0.25, 0.7)
        middle, reach = random.uniform(0, size, 2), int(along) + 2
        top, left = np.maximum(middle.astype(int) - reach, 0)
        part = height[top : int(middle[0]) + reach, left : int(middle[1]) + reach]
        y, x = np.mgrid[: part.shape[0], : part.shape[1]] + np.array(
            [[[top - middle[0]]], [[left - middle[1]]]]
        )
        u, v = turned(x, y, random.uniform(0, 2 * np.pi))
        tilt, fold = random.normal(0, 0.5, 2), random.normal(0, 0.4)
        rise = random.uniform(0, length) + tilt[0] * u + tilt[1] * v + fold * np.abs(v)
        inside = np.abs(v) < across * (1 - (u / along) ** 2)
        part[inside] = np.maximum(part, rise)[inside]
    return height


def patchy(random: Random, size: int) -> Float64:
    """Return a smooth object that has fine detail in some places only."""
    base = smooth(random, size) if random.random() < 0.5 else bodies(random, size)
    kinds = (crusted, faceted, worn, rough)
    fine = kinds[random.integers(len(kinds))](random, size)
    where = random.uniform(1, 6) * power_noise(random, size, random.uniform(1.5, 2.5))
    share = 1 / (1 + np.exp(random.normal(0, 2) - where))
    strength = logarithmic(random, 0.03, 1)
    return np.asarray(base / slope(base) + strength * share * fine / slope(fine))


def warped(random: Random, height: Float64) -> Float64:
    """Return a surface that is folded and sheared sideways, by 0.5 to 8 pixels."""
    size, strength = len(height), logarithmic(random, 0.5, 8)
    power = random.uniform(1.2, 2.2)
    shifts = np.stack([power_noise(random, size, power) for _ in range(2)])
    y, x = (np.mgrid[:size, :size] + strength * shifts).astype(np.float32)
    border = cv2.BORDER_REFLECT_101
    moved = cv2.remap(height.astype(np.float32), x, y, cv2.INTER_CUBIC, borderMode=border)
    return np.asarray(moved, np.float64)


def _waves(random: Random, size: int, wave: float) -> Float64:
    waves = gaussian_filter(random.standard_normal((size, size)), wave / 5, mode="wrap")
    return np.asarray(waves / waves.std())
