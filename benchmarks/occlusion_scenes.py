"""Scenes in which one part of the surface hides another, with known heights.

A scene consists of layers. Each layer is a smooth height over the plane and an outline; the highest
layer that covers a place is seen. The view is orthographic, one unit is one pixel. The normals of
several places of each pixel, or of the neighbourhood that a lens blurs, are averaged. In every
scene except the balls, each part touches the rest of the surface somewhere in sight.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

import processing
from rig.arrays import Bool, Float64

# Height, and whether the layer covers the place, by x to the right and y up.
Layer = Callable[[Float64, Float64], tuple[Float64, Bool]]
Builder = Callable[[np.random.Generator, float], list[Layer]]

_PLACES = 4  # places in a pixel, along each side
_STEP = 1e-4  # px, for the derivatives of a layer


@dataclass(frozen=True, eq=False)
class OccludedScene:
    """Normals and heights of a scene.

    Parameters
    ----------
    normals
        The normals, without noise.
    height
        ``(H, W)`` heights at the centres of the pixels, in pixels.
    """

    normals: processing.NormalMap
    height: Float64

    def noisy(self, noise_deg: float, seed: int) -> processing.NormalMap:
        """Return the normals with noise on each component."""
        rng = np.random.default_rng([seed, 17])
        noise = rng.normal(scale=math.radians(noise_deg), size=self.normals.normals.shape)
        return processing.NormalMap.from_vectors(self.normals.normals + noise, self.normals.mask)


def scene(kind: str, seed: int, size: int = 192, blur_px: float = 0.0) -> OccludedScene:
    """Build a scene of a kind in `KINDS`.

    Parameters
    ----------
    kind
        The kind of the scene.
    seed
        Seed of its shapes.
    size
        Width and height in pixels.
    blur_px
        Standard deviation of the blur of the lens; 0: normals at the centres of the pixels.
    """
    layers = KINDS[kind](np.random.default_rng([seed, *kind.encode()]), float(size))
    height, normals, seen = _seen(layers, size, 1)
    if blur_px:
        _, fine, covered = _seen(layers, size, _PLACES)
        fine[~covered] = 0
        fine = cv2.GaussianBlur(fine, (0, 0), _PLACES * blur_px)
        normals = cv2.resize(fine, (size, size), interpolation=cv2.INTER_AREA)
    return OccludedScene(processing.NormalMap.from_vectors(normals, seen), height)


def _seen(layers: list[Layer], size: int, places: int) -> tuple[Float64, Float64, Bool]:
    """Return height, normals and mask of the highest layers."""
    at = (np.arange(size * places) + 0.5) / places - size / 2
    x, y = np.meshgrid(at, -at)
    height = np.full(x.shape, -np.inf)
    normals = np.zeros((*x.shape, 3))
    for layer in layers:
        z, covers = layer(x, y)
        higher = covers & (z > height)
        height[higher] = z[higher]
        right, left = layer(x + _STEP, y)[0], layer(x - _STEP, y)[0]
        up, down = layer(x, y + _STEP)[0], layer(x, y - _STEP)[0]
        slopes = np.stack([left - right, down - up, np.full_like(x, 2 * _STEP)], axis=-1)
        normals[higher] = (slopes / np.linalg.norm(slopes, axis=-1, keepdims=True))[higher]
    seen = np.isfinite(height)
    height[~seen] = np.nan
    return height, normals, seen


def _waves(rng: np.random.Generator, size: float, slope: float, shortest: float) -> Layer:
    """Return a random smooth ground of a root-mean-square slope."""
    count = 6
    angles = rng.uniform(0, 2 * math.pi, count)
    lengths = size * rng.uniform(shortest, 1.5, count)
    phases = rng.uniform(0, 2 * math.pi, count)
    frequencies = 2 * math.pi / lengths
    heights = slope * math.sqrt(2 / count) / frequencies

    def ground(x: Float64, y: Float64) -> tuple[Float64, Bool]:
        z = np.zeros_like(x)
        for angle, frequency, phase, high in zip(angles, frequencies, phases, heights, strict=True):
            z += high * np.sin(frequency * (math.cos(angle) * x + math.sin(angle) * y) + phase)
        return z, np.ones(x.shape, bool)

    return ground


def _turned(x: Float64, y: Float64, angle: float) -> tuple[Float64, Float64]:
    """Return coordinates along a direction and across it."""
    cos, sin = math.cos(angle), math.sin(angle)
    return cos * x + sin * y, cos * y - sin * x


def _smoothstep(t: Float64) -> Float64:
    t = np.clip(t, 0, 1)
    return np.asarray(t * t * (3 - 2 * t))


def _smooth(rng: np.random.Generator, size: float) -> list[Layer]:
    return [_waves(rng, size, rng.uniform(0.2, 0.8), 0.1)]


def _reliefs(rng: np.random.Generator, size: float) -> list[Layer]:
    """Return plateaus with resolved walls of 45 to 70 degrees: steep, but without jumps."""
    ground = _waves(rng, size, 0.05, 0.4)
    discs = [
        (*rng.uniform(-0.4, 0.4, 2) * size, rng.uniform(0.05, 0.2) * size, rng.uniform(3, 8))
        for _ in range(10)
    ]
    steepness = rng.uniform(0.7, 1.8)

    def relief(x: Float64, y: Float64) -> tuple[Float64, Bool]:
        z, inside = ground(x, y)
        for u, v, radius, high in discs:
            away = np.hypot(x - u, y - v) - radius
            z = z + 0.5 * high * (1 - np.tanh(2 * steepness * away / high))
        return z, inside

    return [relief]


def _balls(rng: np.random.Generator, size: float) -> list[Layer]:
    """Return balls with their centres near a slope, which hide ground on the lower side."""
    tilt = rng.uniform(0.3, 0.8)
    angle = rng.uniform(0, 2 * math.pi)
    slope = tilt * np.array([math.cos(angle), math.sin(angle)])
    waves = _waves(rng, size, 0.05, 0.3)

    def ground(x: Float64, y: Float64) -> tuple[Float64, Bool]:
        z, inside = waves(x, y)
        return z + slope[0] * x + slope[1] * y, inside

    layers: list[Layer] = [ground]
    for _ in range(6):
        u, v = rng.uniform(-0.38, 0.38, 2) * size
        radius = rng.uniform(0.06, 0.16) * size
        centre = float(slope @ [u, v]) + rng.uniform(-0.5, 0.6) * tilt * radius
        layers.append(_ellipsoid((u, v, centre), (radius, radius, radius), 0.0))
    return layers


def _ellipsoid(
    centre: tuple[float, float, float], axes: tuple[float, float, float], angle: float
) -> Layer:
    def upper_half(x: Float64, y: Float64) -> tuple[Float64, Bool]:
        along, across = _turned(x - centre[0], y - centre[1], angle)
        along, across = along / axes[0], across / axes[1]
        left = 1 - along**2 - across**2
        return centre[2] + axes[2] * np.sqrt(np.maximum(left, 1e-9)), left > 1e-3

    return upper_half


def _statues(rng: np.random.Generator, size: float) -> list[Layer]:
    """Return a body with limbs and a head, all of ellipsoids, in front of nothing."""
    layers = [_ellipsoid((0, 0, 0), (0.24 * size, 0.36 * size, 0.2 * size), 0.0)]
    for _ in range(7):
        angle = rng.uniform(0, 2 * math.pi)
        far = rng.uniform(0.1, 0.3) * size
        long, thick = rng.uniform(0.12, 0.2) * size, rng.uniform(0.05, 0.1) * size
        u, v = 0.8 * far * math.cos(angle), far * math.sin(angle)
        w = rng.uniform(0.0, 0.17) * size
        layers.append(_ellipsoid((u, v, w), (long, thick, thick), rng.uniform(0, math.pi)))
    return layers


def _folds(rng: np.random.Generator, size: float) -> list[Layer]:
    """Return sheets that rise slowly to a rim; the rims end where the sheets lie on the ground."""
    ground = _waves(rng, size, rng.uniform(0.05, 0.3), 0.3)
    return [ground, *(_sheet(rng, size, ground) for _ in range(2))]


def _sheet(rng: np.random.Generator, size: float, ground: Layer) -> Layer:
    angle, rim = rng.uniform(0, 2 * math.pi), rng.uniform(-0.25, 0.25) * size
    high, run = rng.uniform(8, 25), rng.uniform(0.25, 0.5) * size
    middle, half = rng.uniform(-0.15, 0.15) * size, rng.uniform(0.2, 0.4) * size
    bend = rng.uniform(-0.1, 0.1) * size

    def sheet(x: Float64, y: Float64) -> tuple[Float64, Bool]:
        along, across = _turned(x, y, angle)
        # The distance behind the rim, which is a curve.
        behind = rim + bend * np.cos(2.5 * across / size) - along
        side = (across - middle) / half
        lift = high * _smoothstep(1 - behind / run) * _smoothstep(1.5 - 1.5 * np.abs(side))
        return ground(x, y)[0] + lift, (behind > 0) & (behind < run) & (np.abs(side) < 1)

    return sheet


def _tongues(rng: np.random.Generator, size: float) -> list[Layer]:
    """Return strips that rise from the ground at one end, straight or curling upwards."""
    ground = _waves(rng, size, rng.uniform(0.05, 0.3), 0.3)
    return [ground, *(_tongue(rng, size, ground) for _ in range(4))]


def _tongue(rng: np.random.Generator, size: float, ground: Layer) -> Layer:
    angle, (u, v) = rng.uniform(0, 2 * math.pi), rng.uniform(-0.3, 0.3, 2) * size
    long, wide = rng.uniform(0.2, 0.5) * size, rng.uniform(0.05, 0.14) * size
    slope, power = rng.uniform(0.15, 0.7), rng.uniform(1, 2)

    def tongue(x: Float64, y: Float64) -> tuple[Float64, Bool]:
        along, across = _turned(x - u, y - v, angle)
        lift = slope * long * np.maximum(along / long, 0) ** power
        end = wide * np.sqrt(np.clip((long - along) / wide, 0, 1))
        return ground(x, y)[0] + lift, (along > 0) & (np.abs(across) < end)

    return tongue


def _spirals(rng: np.random.Generator, size: float) -> list[Layer]:
    """Return a ribbon that rises from the ground while it turns, as a watch spring."""
    ground = _waves(rng, size, rng.uniform(0.05, 0.3), 0.3)
    turns, begin = rng.uniform(0.8, 1.8), rng.uniform(0, 2 * math.pi)
    inner, pitch = rng.uniform(0.1, 0.14) * size, rng.uniform(0.13, 0.17) * size
    wide, rise = rng.uniform(0.5, 0.8) * pitch, rng.uniform(2.5, 8)

    def ribbon(x: Float64, y: Float64) -> tuple[Float64, Bool]:
        radius = np.hypot(x, y)
        angle = np.mod(np.arctan2(y, x) - begin, 2 * math.pi)
        # Number of whole turns at this distance from the centre.
        whole = np.floor((radius - inner + wide / 2) / pitch - angle / (2 * math.pi) + 0.5)
        turned = angle / (2 * math.pi) + whole
        away = radius - inner - pitch * turned
        lift = 2 * math.pi * rise * turned
        covers = (np.abs(away) < wide / 2) & (turned > 0) & (turned < turns)
        return ground(x, y)[0] + lift, covers

    return [ground, ribbon]


def _horns(rng: np.random.Generator, size: float) -> list[Layer]:
    """Return round bars that stick out of the ground at one end."""
    ground = _waves(rng, size, rng.uniform(0.02, 0.2), 0.3)
    return [ground, *(_horn(rng, size) for _ in range(3))]


def _horn(rng: np.random.Generator, size: float) -> Layer:
    angle, (u, v) = rng.uniform(0, 2 * math.pi), rng.uniform(-0.3, 0.3, 2) * size
    radius, long = rng.uniform(0.05, 0.12) * size, rng.uniform(0.25, 0.5) * size
    slope = rng.uniform(0.2, 0.7)

    def horn(x: Float64, y: Float64) -> tuple[Float64, Bool]:
        along, across = _turned(x - u, y - v, angle)
        left = radius**2 - across**2
        z = np.sqrt(np.maximum(left, 1e-6)) + slope * along - 1.2 * radius
        return z, (left > 0.02 * radius**2) & (along < long)

    return horn


def _heaps(rng: np.random.Generator, size: float) -> list[Layer]:
    """Return ellipsoids in many layers on a mound, which hide each other and the mound."""
    waves = _waves(rng, size, 0.05, 0.5)
    steep = rng.uniform(0.25, 0.45) * size

    def mound(x: Float64, y: Float64) -> tuple[Float64, Bool]:
        z, inside = waves(x, y)
        return z + steep * np.exp(-(x**2 + y**2) / (0.3 * size) ** 2), inside

    layers: list[Layer] = [mound]
    for _ in range(40):
        (u, v), angle = rng.uniform(-0.42, 0.42, 2) * size, rng.uniform(0, math.pi)
        long, thick = rng.uniform(0.07, 0.18) * size, rng.uniform(0.04, 0.09) * size
        w = float(mound(np.array(u), np.array(v))[0]) + rng.uniform(-0.3, 0.9) * thick
        layers.append(_ellipsoid((u, v, w), (long, thick, thick), angle))
    return layers


KINDS: Final[dict[str, Builder]] = {
    "smooth": _smooth,
    "reliefs": _reliefs,
    "balls": _balls,
    "statues": _statues,
    "folds": _folds,
    "tongues": _tongues,
    "spirals": _spirals,
    "horns": _horns,
    "heaps": _heaps,
}
