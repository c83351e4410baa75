"""Errors of normals from photographs by hand: the camera drifts, and a lamp is moved by hand.

An object and one chrome ball are photographed under 60 directions of a lamp, which only the ball
shows. The camera drifts in one direction, by the number of pixels in the table from the first
image to the last, with a jitter of a tenth of that; it moves without turning, turns without moving, or
also rolls and comes nearer. Normals are those of the commands with ``--spheres --radius-mm
--semi-calibrated`` of a camera that stands still and of one that drifts, against the true normals
at the median position.

    python benchmarks/hand_held.py --seed 71 --out docs/measured/hand-held.csv
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from acquisition import CameraModel, Lights
from rig.arrays import Bool, Float64, UInt16
from simulator import Rendering, Scene, render, scene_named
from simulator.camera import sensor_image
from simulator.scene import ChromeSphere
from simulator.shapes import Body, Even, Pattern
from simulator.shapes.body import BodyHits, HeightGrid

OBJECTS = ("coin", "woodcarving", "leather")
SIZE = (640, 512)
RADIUS_MM = 15.0
_BALL_MM = (-106.0, -78.0)
_LAMP_MM = 2500.0
_EXPOSED = 0.7
_BOARD = 0.2


@dataclass(frozen=True)
class _MovedBody:
    """A body elsewhere on the board."""

    body: Body
    by_mm: tuple[float, float]

    @property
    def radius_mm(self) -> float:
        return self.body.radius_mm + float(np.hypot(*self.by_mm))

    @property
    def top_mm(self) -> float:
        return self.body.top_mm

    def inside(self, x_mm: Float64, y_mm: Float64) -> Bool:
        return self.body.inside(x_mm - self.by_mm[0], y_mm - self.by_mm[1])

    def trace(self, origins_mm: Float64, directions: Float64) -> BodyHits:
        by = np.array([*self.by_mm, 0.0])
        hits = self.body.trace(origins_mm - by, directions)
        points = np.where(hits.hit[..., None], hits.points_mm + by, 0.0)
        return replace(hits, points_mm=points)

    def shadow_caster(self, step_mm: float) -> HeightGrid:
        grid = self.body.shadow_caster(step_mm)
        x, y = grid.origin_xy_mm
        return replace(grid, origin_xy_mm=(x + self.by_mm[0], y + self.by_mm[1]))


@dataclass(frozen=True)
class _MovedPattern(Pattern):
    """Paint elsewhere on the board."""

    pattern: Pattern
    by: tuple[float, float]

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> Float64:
        return self.pattern.evaluate(x_mm - self.by[0], y_mm - self.by[1])


def lamp_by_hand(count: int, rng: np.random.Generator) -> Lights:
    """Return the positions of a lamp that is moved at random over the hemisphere."""
    up, azimuth = rng.uniform(0.35, 0.95, count), rng.uniform(0, 2 * np.pi, count)
    across = np.sqrt(1 - up**2)
    far = _LAMP_MM * rng.normal(1, 0.05, count)
    way = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), up], axis=1)
    return Lights(positions_mm=far[:, None] * way, intensities=(_LAMP_MM / far) ** 2)


def seen(scene: Scene, right_px: float, down_px: float, kind: str) -> Scene:
    """Return a scene as a camera sees it that moved or turned, so that its image is shifted."""
    camera = scene.lens.camera
    if kind == "turns":
        K = np.array(camera.K)
        K[:2, 2] += right_px, down_px
        moved = CameraModel(K, camera.width, camera.height, camera.working_distance_mm)
        return replace(scene, lens=replace(scene.lens, camera=moved))
    pixel = camera.working_distance_mm / camera.focal_px
    by = right_px * pixel, -down_px * pixel
    spheres = tuple(
        replace(one, centre_mm=(one.centre_mm[0] + by[0], one.centre_mm[1] + by[1], one.radius_mm))
        for one in scene.spheres
    )
    places = np.asarray(scene.lights.positions_mm) + [*by, 0.0]
    return replace(
        scene,
        body=_MovedBody(scene.body, by),
        pattern=_MovedPattern(scene.pattern, by),
        spheres=spheres,
        lights=replace(scene.lights, positions_mm=places),
    )


def drift(count: int, pixels: float, rng: np.random.Generator) -> Float64:
    """Return shifts ``(N, 2)`` of a camera that drifts, right and down."""
    way = rng.uniform(0, 2 * np.pi)
    line = np.linspace(0, pixels, count)[:, None] * [np.cos(way), np.sin(way)]
    return np.asarray(line + rng.normal(0, pixels / 30, (count, 2)))


def photographs(
    name: str, shifts: Float64, kind: str, seed: int, size: tuple[int, int] = SIZE
) -> tuple[UInt16, Rendering]:
    """Return images ``(N, H, W)`` of 16 bits, and what a camera at the median position sees."""
    rng = np.random.default_rng(seed)
    lights = lamp_by_hand(len(shifts), rng)
    scene = scene_named(name, width=size[0], height=size[1], leds=1, seed=seed)
    ball = ChromeSphere((*_BALL_MM, RADIUS_MM), RADIUS_MM)
    scene = replace(scene, spheres=(ball,), board=Even(_BOARD))
    still = render(seen(replace(scene, lights=lights.take([0])), *np.median(shifts, axis=0), kind))
    sensor = scene.noise
    white = (sensor.converter_end_dn - sensor.black_level_dn) * sensor.electrons_per_dn
    images, brightest = [], []
    for k, (right, down) in enumerate(shifts.tolist()):
        one = seen(replace(scene, lights=lights.take([k])), right, down, kind)
        made = render(one)
        images.append(made.planes[0] + made.ambient)
        brightest.append(np.percentile(made.planes[0], 99.5))
    exposure_us = _EXPOSED * white / max(brightest)
    frames = [
        sensor_image(image * np.float32(exposure_us), sensor, key=(seed, k))
        for k, image in enumerate(images)
    ]
    signal = np.maximum(np.array(frames, np.int64) - round(sensor.black_level_dn), 0)
    top = sensor.converter_end_dn - sensor.black_level_dn
    return np.minimum(np.rint(signal * (65535 / top)), 65535).astype(np.uint16), still
