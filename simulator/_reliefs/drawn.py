"""Reliefs with a design: weaves, strokes of a tool, and bodies that overlap."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from simulator._reliefs.noise import power_noise

Array = npt.NDArray[np.float64]
Random = np.random.Generator


def weave(random: Random, size: int) -> Array:
    """Return a plain weave, parallel ribs or a quilted grid, bent a little, 8 to 40 pixels wide."""
    y, x = np.mgrid[:size, :size].astype(float)
    width = random.uniform(8, 40)
    x = x + 0.1 * width * random.random() * power_noise(random, size, 2.2)
    y = y + 0.1 * width * random.random() * power_noise(random, size, 2.2)
    u, v = _turned(x, y, random.uniform(0, math.pi))
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


def strokes(random: Random, size: int) -> Array:
    """Return raised and engraved strokes, straight or bent: angular, flat or round profiles."""
    y, x = np.mgrid[:size, :size].astype(float)
    height = np.zeros((size, size))
    for _ in range(random.integers(3, 25)):
        left, top = random.uniform(0, size, 2)
        u, v = _turned(x - left, y - top, random.uniform(0, math.pi))
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


def bodies(random: Random, size: int) -> Array:
    """Return ellipsoids that rest on a plane and hide parts of each other, in pixels."""
    y, x = np.mgrid[:size, :size].astype(float)
    height = np.zeros((size, size))
    for _ in range(random.integers(2, 14)):
        left, top = random.uniform(-20, size + 20, 2)
        axes = random.uniform(8, 90, 2)
        u, v = _turned(x - left, y - top, random.uniform(0, math.pi))
        inside = np.maximum(1 - (u / axes[0]) ** 2 - (v / axes[1]) ** 2, 0)
        rise = random.uniform(0.3, 1) * axes.min()
        height = np.maximum(height, rise * np.sqrt(inside) + random.uniform(-5, 5))
    return height


def _turned(x: Array, y: Array, angle: float) -> tuple[Array, Array]:
    c, s = math.cos(angle), math.sin(angle)
    return c * x + s * y, c * y - s * x
