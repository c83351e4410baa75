"""Random layouts of mirror spheres on boards: their scenes, images and truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acquisition import CameraModel
from rig.arrays import Float32, Float64
from simulator import ChromeSphere, Lens, Scene, bench_camera, bench_sensor, dome_lights, render
from simulator.camera import sensor_image
from simulator.scene import Ball, Box
from simulator.shapes import (
    BandNoise,
    ChArUco,
    Checker,
    Cork,
    Even,
    Gradient,
    Paint,
    Pattern,
    Print,
    Textile,
    Weave,
    Wood,
)

# Width, height, and how often a size is drawn.
SIZES = (((640, 512), 0.5), ((960, 804), 0.3), ((1280, 1024), 0.15), ((2448, 2048), 0.05))
SMALL_SIZES = (((640, 512), 0.8), ((960, 804), 0.2))
RADII_MM = (8.0, 10.0, 12.0, 15.0, 18.0, 20.0, 25.0, 30.0)
SMALLEST_PX = 20.0
LONG_US, SHORT_US = 20000.0, 15.0


@dataclass(frozen=True, eq=False)
class Layout:
    """A rendered layout and its truth."""

    seed: int
    kind: str
    values: Float32
    camera: CameraModel
    spheres: tuple[ChromeSphere, ...]
    lights_mm: Float64

    def outlines(self) -> Iterator[tuple[ChromeSphere, Float64]]:
        """Yield each sphere and the pixels of its outline, ``(M, 2)``."""
        for sphere in self.spheres:
            yield sphere, outline(self.camera, sphere)

    def wanted(self) -> list[ChromeSphere]:
        """Return the spheres that must be found: completely visible, of 20 px or more."""
        limit = np.array([self.camera.width, self.camera.height]) - 4.0
        return [
            sphere
            for sphere, points in self.outlines()
            if np.all((points > 3) & (points < limit)) and radius_px(points) >= SMALLEST_PX
        ]


def outline(camera: CameraModel, sphere: ChromeSphere, count: int = 180) -> Float64:
    """Return the pixels ``(count, 2)`` where rays touch a sphere."""
    axis = np.array(sphere.centre_mm) - camera.centre_mm
    distance = float(np.linalg.norm(axis))
    axis = axis / distance
    first = np.cross(axis, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    angle = np.arange(count) * (2 * np.pi / count)
    around = np.outer(np.cos(angle), first) + np.outer(np.sin(angle), np.cross(axis, first))
    sine = sphere.radius_mm / distance
    touch = distance * (1 - sine**2) * axis + sphere.radius_mm * np.sqrt(1 - sine**2) * around
    pixels: Float64 = camera.project(camera.centre_mm + touch)
    return pixels


def radius_px(points: Float64) -> float:
    """Return the mean radius of an outline."""
    return float(np.linalg.norm(points - points.mean(axis=0), axis=1).mean())


def board_of(kind: str, rng: np.random.Generator) -> Pattern:
    """Draw a board."""
    seed = int(rng.integers(1 << 30))
    if kind == "plain":
        choice = rng.integers(3)
        if choice == 0:
            return Even(float(rng.uniform(0.05, 0.8)))
        if choice == 1:
            low = float(rng.uniform(0.1, 0.4))
            return Gradient(
                low, low + 0.3, float(rng.uniform(150, 400)), float(rng.uniform(0, 360))
            )
        return Paint(0.35, 0.6, float(rng.uniform(80, 200)), seed)
    low, high = float(rng.uniform(0.04, 0.3)), float(rng.uniform(0.5, 0.9))
    turn = float(rng.uniform(0, 180))
    boards: tuple[Callable[[], Pattern], ...] = (
        lambda: Checker(low, high, float(rng.uniform(4, 30))),
        lambda: Checker(low, high, float(rng.uniform(4, 30))),
        lambda: ChArUco(20, 16, float(rng.uniform(12, 24)), low, high),
        lambda: Paint(low, high, float(rng.uniform(6, 40)), seed),
        lambda: Cork(low, high, float(rng.uniform(2, 5)), seed),
        lambda: Wood(low, high, angle_deg=turn, seed=seed),
        lambda: Print(high, low, float(rng.uniform(4, 10)), turn, seed),
        lambda: Weave(low, high, float(rng.uniform(1, 3)), turn, seed),
    )
    return boards[rng.integers(len(boards))]()


def scene_of(seed: int, kind: str, *, small: bool) -> Scene:
    """Draw a layout."""
    rng = np.random.default_rng((seed, kind == "patterned"))
    sizes = SMALL_SIZES if small else SIZES
    width, height = sizes[rng.choice(len(sizes), p=[share for _, share in sizes])][0]
    camera = bench_camera(width, height)
    leds = int(rng.choice([16, 24, 36]))
    board = board_of(kind, rng)
    body = relief = None
    pattern: Pattern = Even(0.6)
    part = rng.random()
    if part < 0.15:
        body = Textile(float(rng.uniform(25, 50)), 1.0, int(rng.integers(1 << 30)))
        pattern = Paint(0.3, 0.7, 30.0, int(rng.integers(1 << 30)))
    elif part < 0.3:
        relief = BandNoise(200.0, float(rng.uniform(0.03, 0.12)), 12.0, 3.0, seed)
    radii = rng.choice(RADII_MM, int(rng.integers(1, 4)), replace=False)
    spheres: list[ChromeSphere] = []
    field_mm = 294.0
    cut = rng.random() < 0.15
    for index in range(int(rng.integers(1, 7))):
        for _ in range(60):
            radius = float(rng.choice(radii))
            half_x, half_y = field_mm / 2, field_mm / 2 * height / width
            edge = -1.1 * radius if not (cut and index == 0) else 0.4 * radius
            x = float(rng.uniform(-1, 1) * (half_x + edge) * (1 - radius / 600))
            y = float(rng.uniform(-1, 1) * (half_y + edge) * (1 - radius / 600))
            apart = all(
                np.hypot(x - s.centre_mm[0], y - s.centre_mm[1]) > 1.15 * (radius + s.radius_mm)
                for s in spheres
            )
            free = body is None or np.hypot(x, y) > 1.1 * (body.radius_mm + radius)
            if apart and free:
                reflectance = float(rng.uniform(0.45, 0.9))
                spheres.append(ChromeSphere((x, y, radius), radius, reflectance))
                break
    return Scene(
        body=body,
        lights=dome_lights(leds, seed=seed),
        lens=Lens(camera, sharp=False),
        noise=bench_sensor(),
        electrons_per_us=0.42,
        pattern=pattern,
        board=board,
        relief=relief,
        spheres=tuple(spheres),
        clutter=clutter_of(spheres, 0.0 if body is None else body.radius_mm, rng),
    )


def clutter_of(
    spheres: list[ChromeSphere], middle_mm: float, rng: np.random.Generator
) -> tuple[Ball | Box, ...]:
    """Draw a matte ball, a glossy ball and a box, each in a third of the layouts."""
    items: list[Ball | Box] = []
    taken = [(*s.centre_mm[:2], s.radius_mm) for s in spheres] + [(0.0, 0.0, middle_mm)]
    for kind in ("matte", "glossy", "box"):
        if rng.random() > 0.35:
            continue
        for _ in range(30):
            size = float(rng.uniform(10, 25))
            x, y = float(rng.uniform(-110, 110)), float(rng.uniform(-85, 85))
            if any(np.hypot(x - a, y - b) < 1.2 * (size + r) for a, b, r in taken):
                continue
            albedo = float(rng.uniform(0.1, 0.8))
            if kind == "box":
                turn = float(rng.uniform(0, 90))
                items.append(Box((x, y), (size, 0.8 * size, 0.6 * size), turn, albedo))
            else:
                roughness = float(rng.uniform(0.1, 0.35)) if kind == "glossy" else None
                items.append(Ball((x, y, size), size, albedo, roughness))
            taken.append((x, y, size))
            break
    return tuple(items)


def record(scene: Scene, seed: int) -> Float32:
    """Render a scene and merge two exposures of each image; NaN where both are saturated."""
    rendering, images = render(scene), []
    noise, width = scene.noise, scene.lens.size[1]
    exposures = (LONG_US, SHORT_US * (640 / width) ** 2)
    span = noise.white_level_dn - noise.black_level_dn
    for led, plane in enumerate(rendering.planes):
        rate = plane + rendering.ambient
        merged = None
        for bracket, exposure_us in enumerate(exposures):
            electrons = (rate * exposure_us).astype(np.float32)
            dn = sensor_image(electrons, noise, key=(seed, led, bracket)).astype(np.float32)
            value = (dn - noise.black_level_dn) / span * exposures[0] / exposure_us
            value[dn >= noise.white_level_dn] = np.nan
            merged = value if merged is None else np.where(np.isnan(merged), value, merged)
        images.append(merged)
    return np.array(images, np.float32)


def layout_of(seed: int, kind: str, *, small: bool, cache: Path | None = None) -> Layout:
    """Return a layout, from the cache if it is there."""
    scene = scene_of(seed, kind, small=small)
    place = None if cache is None else cache / f"{kind}-{seed}-{'small' if small else 'all'}.npy"
    if place is not None and place.exists():
        values: Float32 = np.load(place)
    else:
        values = record(scene, seed)
        if place is not None:
            np.save(place, values)
    lights_mm = np.asarray(scene.lights.positions_mm)
    return Layout(
        seed, kind, values, bench_camera(*scene.lens.size[::-1]), scene.spheres, lights_mm
    )
