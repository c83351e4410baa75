"""Reliefs with a design: weaves, strokes of a tool, and bodies that overlap."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from rig.arrays import Float64, Intp
from simulator.reliefs.measurement import power_noise, slope, turned

Random = np.random.Generator


def weave(random: Random, size: int) -> Float64:
    """Return a plain weave, parallel ribs or a quilted grid, bent a little, 8 to 40 pixels wide."""
    y, x = np.mgrid[:size, :size].astype(float)
    width = random.uniform(8, 40)
    x = x + 0.1 * width * random.random() * power_noise(random, size, 2.2)
    y = y + 0.1 * width * random.random() * power_noise(random, size, 2.2)
    u, v = turned(x, y, random.uniform(0, math.pi))
    u, v = u / width, v / width
    kind = random.integers(3)
    if kind == 0:
        over = np.where((np.floor(u) + np.floor(v)) % 2 > 0, 1, -1)
        weft = over * np.sin(math.pi * u) * np.abs(np.sin(math.pi * v))
        warp = 0.8 * np.abs(np.cos(math.pi * v))
        return np.asarray(np.maximum(weft, warp))
    if kind == 1:
        return np.asarray(np.abs(np.sin(math.pi * u)) ** random.uniform(0.4, 3))
    return np.asarray(np.sin(2 * math.pi * u) * np.sin(2 * math.pi * v))


def strokes(random: Random, size: int) -> Float64:
    """Return raised and engraved strokes, straight or bent: angular, flat or round profiles."""
    y, x = np.mgrid[:size, :size].astype(float)
    height = np.zeros((size, size))
    for _ in range(random.integers(3, 25)):
        left, top = random.uniform(0, size, 2)
        u, v = turned(x - left, y - top, random.uniform(0, math.pi))
        length, half = random.uniform(10, 120), random.uniform(1.5, 9)
        v = v - random.normal(0, 0.01) * u**2
        beyond = np.maximum(np.abs(u) - length / 2, 0)
        inside = np.maximum(1 - np.hypot(beyond, v) / half, 0)
        profile = random.choice(["angular", "flat", "round"], p=[0.5, 0.25, 0.25])
        if profile == "flat":
            inside = np.minimum(3 * inside, 1)
        elif profile == "round":
            inside = np.sqrt(inside)
        height += random.choice([-1, 1]) * inside
    return height


def bodies(random: Random, size: int) -> Float64:
    """Return ellipsoids that rest on a plane and hide parts of each other, in pixels."""
    y, x = np.mgrid[:size, :size].astype(float)
    height = np.zeros((size, size))
    for _ in range(random.integers(2, 14)):
        left, top = random.uniform(-20, size + 20, 2)
        axes = random.uniform(8, 90, 2)
        u, v = turned(x - left, y - top, random.uniform(0, math.pi))
        inside = np.maximum(1 - (u / axes[0]) ** 2 - (v / axes[1]) ** 2, 0)
        rise = random.uniform(0.3, 1) * axes.min()
        height = np.maximum(height, rise * np.sqrt(inside) + random.uniform(-5, 5))
    return height


def summed(
    random: Random, size: int, part_of: Callable[[Random, int], Float64], bodies_share: float
) -> Float64:
    """Return the sum of one to three parts, and, in a share of all cases, of bodies."""
    height = np.zeros((size, size))
    for _ in range(random.integers(1, 4)):
        part = part_of(random, size)
        height += random.uniform(0.2, 1) / slope(gaussian_filter(part, 0.7)) * part
    if random.random() < bodies_share:
        height += random.uniform(0.1, 0.6) * bodies(random, size)
    return height


def cells(random: Random, size: int) -> Float64:
    """Return a relief from the distances to the two nearest points (Worley 1996).

    Parameters
    ----------
    random
        Source of random numbers.
    size
        Side of the square in pixels; cells are 8 to 48 pixels wide.

    Returns
    -------
    Array
        ``(size, size)`` heights, about 1 high.
    """
    width = random.uniform(8, 48)
    points = _rows(random, size, width) if random.random() < 0.4 else _anywhere(random, size, width)
    first, second, nearest = _distances(random, size, width, points)
    gap = (second - first) / width
    kind = random.integers(4)
    if kind == 0:  # cracks
        return -np.exp(-((gap / random.uniform(0.05, 0.4)) ** 2))
    if kind == 1:  # pebbles
        steepness = random.uniform(0.8, 1.6)
        return np.sqrt(np.maximum(1 - steepness * (first / width) ** 2, 0))
    if kind == 2:  # plates with joints
        return np.tanh(gap / random.uniform(0.1, 0.5))
    levels = random.uniform(0, 1, len(points))[nearest]  # plates on several levels
    return np.asarray(levels * random.uniform(0.2, 1) + 0.3 * np.tanh(gap / 0.2))


def _anywhere(random: Random, size: int, width: float) -> Float64:
    """Return points anywhere, also around the square, so that its edge looks like its middle."""
    count = int((size / width + 4) ** 2)
    return random.uniform(-2 * width, size + 2 * width, (count, 2))


def _rows(random: Random, size: int, width: float) -> Float64:
    """Return a jittered grid, its odd rows shifted by half a cell or not."""
    steps = np.arange(-2, size / width + 4)
    grid = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    grid[:, 0] += grid[:, 1] % 2 / 2 * random.integers(2)
    jitter = random.normal(0, random.uniform(0, 0.3), grid.shape)
    return np.asarray(width * (grid + jitter))


def _distances(
    random: Random, size: int, width: float, points: Float64
) -> tuple[Float64, Float64, Intp]:
    """Return the distances to the two nearest points, in a warped plane, and which is nearest."""
    y, x = np.mgrid[:size, :size].astype(float)
    bend = random.uniform(0, 0.35) * width
    x, y = x + bend * power_noise(random, size, 2.0), y + bend * power_noise(random, size, 2.0)
    found = cKDTree(points).query(np.stack([x, y], -1), k=2)
    distances, indices = np.asarray(found[0]), np.asarray(found[1], np.intp)
    return distances[..., 0], distances[..., 1], indices[..., 0]
