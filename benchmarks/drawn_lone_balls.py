"""Drawn images of a mirror ball on a dark cloth in a cluttered room, without a plane around it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from rig.arrays import Float32, Float64

HEIGHT, WIDTH, FINE = 300, 360, 2
AMBIENT = 0.15
_FAR = 1e6


@dataclass(frozen=True, eq=False)
class LoneBall:
    """A drawn recording of one ball.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, NaN where saturated.
    circle
        Centre x, centre y and radius of the ball in pixels.
    directions
        ``(N, 3)`` unit directions toward the lights, in the house frame.
    """

    values: Float32
    circle: tuple[float, float, float]
    directions: Float64


@dataclass(frozen=True, eq=False)
class _Hit:
    """What rays meet: distances, points, normals and albedos."""

    distance: Float64
    point: Float64
    normal: Float64
    albedo: Float64


Surface = Callable[[Float64, Float64], tuple[Float64, Float64, Float64]]


def lone_ball(seed: int, lights: int = 12) -> LoneBall:
    """Draw a ball, which parallel rays see, and what it mirrors.

    Lengths are in radii of the ball, whose centre is the origin; Z is toward the camera, and Y is
    up. The ball stands on a dark cloth of finite size on a table, with other objects around it, in
    a room whose walls have patches. Lights are at 8 to 15 radii; they shine on everything, and the
    ball and the objects cast shadows.
    """
    rng = np.random.default_rng(seed)
    radius = rng.uniform(45, 110)
    x, y = WIDTH / 2 + rng.uniform(-25, 25), HEIGHT / 2 + rng.uniform(-20, 20)
    surfaces, blockers = _room(rng)
    columns, rows = (np.arange(n * FINE) + 0.5 for n in (WIDTH, HEIGHT))
    u, v = np.meshgrid((columns / FINE - 0.5 - x) / radius, -(rows / FINE - 0.5 - y) / radius)
    on_ball = np.hypot(u, v) < 1
    start = np.stack([u, v, np.full_like(u, 50.0)], axis=-1).reshape(-1, 3)
    toward = np.broadcast_to([0.0, 0.0, -1.0], start.shape).copy()
    inside = on_ball.ravel()
    normals = start[inside].copy()
    normals[:, 2] = np.sqrt(1 - np.sum(normals[:, :2] ** 2, axis=1))
    start[inside] = normals
    toward[inside] = 2 * normals[:, 2:] * normals - np.array([0, 0, 1.0])
    hit = _cast(surfaces, start, toward)
    gain = np.where(inside, rng.uniform(0.5, 0.75), 1.0)
    blur = rng.uniform(0.4, 1.2)
    bits, noise = rng.choice([8, 12]), rng.uniform(0.0005, 0.003)
    directions = _lights(rng, lights)
    distances = rng.uniform(8, 15)
    exposure = rng.uniform(0.6, 1.4) * 0.35
    pictures = []
    for k in range(lights):
        shade = gain * _shade(hit, directions[k] * distances, distances, blockers)
        fine = shade.reshape(u.shape).astype(np.float32)
        fine = cv2.GaussianBlur(fine, (0, 0), blur * FINE)
        pictures.append(cv2.resize(fine, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA))
    values = np.array(pictures)
    values *= exposure / np.percentile(values, 95)
    rows_px, columns_px = np.mgrid[:HEIGHT, :WIDTH]
    for k in range(lights):
        half = directions[k] + np.array([0, 0, 1.0])
        half /= np.linalg.norm(half)
        off = np.hypot(columns_px - x - radius * half[0], rows_px - y + radius * half[1])
        values[k] += 40 * np.exp(-0.5 * (off / (0.03 * radius)) ** 2)
        values[k] += rng.normal(size=off.shape) * noise * np.sqrt(4 * np.minimum(values[k], 1) + 1)
    steps = 2**bits - 1
    values = np.round(np.clip(values, 0, 1) * steps) / steps
    return LoneBall(
        np.where(values >= 1, np.nan, values).astype(np.float32), (x, y, radius), directions
    )


def _lights(rng: np.random.Generator, count: int) -> Float64:
    tilt, turn = np.arcsin(rng.uniform(0.1, 0.75, count)), rng.uniform(0, 2 * np.pi, count)
    flat = np.sin(tilt)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), np.cos(tilt)])


def _room(rng: np.random.Generator) -> tuple[list[Surface], Float64]:
    """Return what rays can meet, and the spheres ``(B, 4)`` that cast shadows."""
    tilt, lean = np.radians(rng.uniform(20, 75)), np.radians(rng.uniform(-12, 12))
    # The upward normal of the table, seen from the camera at this elevation.
    up = np.array([np.sin(lean) * np.cos(tilt), np.cos(lean) * np.cos(tilt), np.sin(tilt)])
    right = np.cross([0.0, 0.0, 1.0], up)
    right /= np.linalg.norm(right)
    front = np.cross(right, up)
    height = 1 + rng.choice([0.0, 0.3, 1.0])
    half = rng.uniform([1.3, 1.3], [6, 6])
    turn = rng.uniform(0, np.pi / 2)
    cloth, table = np.exp(rng.uniform(*np.log([0.001, 0.06]))), rng.uniform(0.04, 0.6)
    grain = _texture(rng, 0.5)

    def ground(start: Float64, toward: Float64) -> tuple[Float64, Float64, Float64]:
        speed = toward @ up
        distance = np.where(speed < -1e-9, -(height + start @ up) / np.minimum(speed, -1e-9), _FAR)
        distance = np.where(distance > 1e-6, distance, _FAR)
        point = start + np.minimum(distance, 1e3)[:, None] * toward
        a, b = point @ right, point @ front
        a, b = a * np.cos(turn) + b * np.sin(turn), b * np.cos(turn) - a * np.sin(turn)
        on_cloth = (np.abs(a) < half[0]) & (np.abs(b) < half[1])
        albedo = np.where(on_cloth, cloth, table * grain(a, b))
        albedo = np.where(np.maximum(np.abs(a), np.abs(b)) > 12, 0.1 * table, albedo)
        return distance, np.broadcast_to(up, start.shape), albedo

    surfaces: list[Surface] = [ground]
    blockers = [np.array([0.0, 0.0, 0.0, 1.0])]
    for _ in range(rng.integers(2, 9)):
        size, far, side = rng.uniform(0.2, 1.5), rng.uniform(2.2, 8), rng.uniform(0, 2 * np.pi)
        middle = (size * rng.uniform(0.6, 3) - height) * up
        middle = middle + (1 + size + far) * (np.cos(side) * right + np.sin(side) * front)
        # Nothing hides the ball.
        if np.hypot(middle[0], middle[1]) < 1.3 + size:
            continue
        surfaces.append(_globe(middle, size, rng.uniform(0.02, 0.9)))
        blockers.append(np.append(middle, size))
    surfaces.append(_walls(rng, up))
    return surfaces, np.array(blockers)


def _globe(middle: Float64, size: float, albedo: float) -> Surface:
    def meet(start: Float64, toward: Float64) -> tuple[Float64, Float64, Float64]:
        offset = start - middle
        along = np.sum(offset * toward, axis=1)
        square = along**2 - np.sum(offset**2, axis=1) + size**2
        distance = np.where(square > 0, -along - np.sqrt(np.maximum(square, 0)), _FAR)
        distance = np.where(distance > 1e-6, distance, _FAR)
        normal = (offset + np.minimum(distance, 1e3)[:, None] * toward) / size
        return distance, normal, np.full(len(start), albedo)

    return meet


def _walls(rng: np.random.Generator, up: Float64) -> Surface:
    """A large sphere around everything, painted with rectangles."""
    size = rng.uniform(20, 60)
    base = rng.choice([0.02, 0.15, 0.5])
    patches = [
        (rng.normal(size=3), rng.uniform(0.1, 0.7), rng.uniform(0.01, 0.9))
        for _ in range(rng.integers(3, 14))
    ]

    def meet(start: Float64, toward: Float64) -> tuple[Float64, Float64, Float64]:
        along = np.sum(start * toward, axis=1)
        distance = np.sqrt(along**2 - np.sum(start**2, axis=1) + size**2) - along
        normal = -(start + distance[:, None] * toward) / size
        albedo = np.full(len(start), base)
        for middle, wide, level in patches:
            towards = middle / np.linalg.norm(middle)
            across = np.cross(up, towards)
            across /= np.linalg.norm(across)
            along = np.cross(towards, across)
            front = -normal @ towards
            on = (np.abs(normal @ across) < wide) & (np.abs(normal @ along) < 0.6 * wide)
            albedo = np.where(on & (front > 0), level, albedo)
        return distance, normal, albedo

    return meet


def _texture(rng: np.random.Generator, contrast: float) -> Callable[[Float64, Float64], Float64]:
    waves = [(rng.normal(size=2) * s, rng.uniform(0, 6.3)) for s in (0.5, 1, 2, 4) for _ in "ab"]

    def texture(a: Float64, b: Float64) -> Float64:
        total = np.zeros_like(a)
        for (p, q), phase in waves:
            total += np.sin(p * a + q * b + phase)
        return np.asarray(np.exp(contrast * total / 2) / 2)

    return texture


def _cast(surfaces: list[Surface], start: Float64, toward: Float64) -> _Hit:
    nearest = np.full(len(start), _FAR)
    normal, albedo = np.zeros_like(start), np.zeros(len(start))
    for surface in surfaces:
        distance, facing, paint = surface(start, toward)
        closer = distance < nearest
        nearest = np.where(closer, distance, nearest)
        normal = np.where(closer[:, None], facing, normal)
        albedo = np.where(closer, paint, albedo)
    return _Hit(nearest, start + nearest[:, None] * toward, normal, albedo)


def _shade(hit: _Hit, light: Float64, reference: float, blockers: Float64) -> Float64:
    """Return the brightness of what rays meet under one light, 1 for white at the ball."""
    offset = light - hit.point
    distance = np.linalg.norm(offset, axis=1)
    toward = offset / distance[:, None]
    cosine = np.sum(toward * hit.normal, axis=1)
    lit = np.maximum(cosine, 0) * (reference / np.maximum(distance, 0.3 * reference)) ** 2
    for *middle, size in blockers:
        away = hit.point - np.array(middle)
        along = -np.sum(away * toward, axis=1)
        passing = np.sum(away**2, axis=1) - along**2
        outside = np.sum(away**2, axis=1) > (1.0001 * size) ** 2
        hidden = (passing < size**2) & (along > 0) & (along < distance) & outside
        lit = np.where(hidden, 0.0, lit)
    return np.asarray(hit.albedo * (lit + AMBIENT * 0.1))
