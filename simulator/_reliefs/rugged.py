"""Rugged surfaces: broken, worn and folded material, foliage, and detail in some places only."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from simulator._reliefs.drawn import bodies
from simulator._reliefs.measured import logarithmic, slope
from simulator._reliefs.noise import power_noise, rough, smooth

Array = npt.NDArray[np.float64]
Random = np.random.Generator

_SHORTEST_PX = 2.5
_LARGEST_GAIN = 6.0


def crusted(random: Random, size: int) -> Array:
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


def faceted(random: Random, size: int) -> Array:
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


def worn(random: Random, size: int) -> Array:
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


def foliage(random: Random, size: int) -> Array:
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
        angle = random.uniform(0, 2 * np.pi)
        u, v = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
        tilt, fold = random.normal(0, 0.5, 2), random.normal(0, 0.4)
        rise = random.uniform(0, length) + tilt[0] * u + tilt[1] * v + fold * np.abs(v)
        inside = np.abs(v) < across * (1 - (u / along) ** 2)
        part[inside] = np.maximum(part, rise)[inside]
    return height


def patchy(random: Random, size: int) -> Array:
    """Return a smooth object that has fine detail in some places only."""
    base = smooth(random, size) if random.random() < 0.5 else bodies(random, size)
    kinds = (crusted, faceted, worn, rough)
    fine = kinds[random.integers(len(kinds))](random, size)
    where = random.uniform(1, 6) * power_noise(random, size, random.uniform(1.5, 2.5))
    share = 1 / (1 + np.exp(random.normal(0, 2) - where))
    strength = logarithmic(random, 0.03, 1)
    return np.asarray(base / slope(base) + strength * share * fine / slope(fine))


def warped(random: Random, height: Array) -> Array:
    """Return a surface that is folded and sheared sideways, by 0.5 to 8 pixels."""
    size, strength = len(height), logarithmic(random, 0.5, 8)
    power = random.uniform(1.2, 2.2)
    y, x = np.mgrid[:size, :size] + strength * np.stack(
        [power_noise(random, size, power) for _ in range(2)]
    )
    moved = cv2.remap(
        height.astype(np.float32),
        x.astype(np.float32),
        y.astype(np.float32),
        cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REFLECT_101,
    )
    return np.asarray(moved, np.float64)


def _waves(random: Random, size: int, wave: float) -> Array:
    waves = gaussian_filter(random.standard_normal((size, size)), wave / 5, mode="wrap")
    return np.asarray(waves / waves.std())
