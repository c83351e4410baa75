"""Random layouts of mirror spheres: which are found, and how wrong are the positions of the lights.

Each seed draws a layout: 1 to 6 spheres of one to three sizes that rest on a plain or a patterned
board, some with a relief, a matte ball, a glossy ball or a box, some cut by the frame. The images
are rendered with the point-spread function of the lens, recorded with two exposures by a 12-bit
sensor, and calibrated with the camera and the radii of all spheres. Only spheres that are
completely visible and have a radius of at least 20 px must be found; other true spheres may be. A
sphere that is found away from every true one is false. A layout is solvable if two such spheres or
more are in it.

    python benchmarks/sphere_layouts.py --board patterned --first 5000 --layouts 100
"""

from __future__ import annotations

import argparse
import resource
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel
from calibration import EstimateError, SphereCalibration, calibrate_spheres, find_spheres
from calibration._spheres.ellipse import Ellipse
from simulator import (
    Ball,
    BandNoise,
    Box,
    ChArUco,
    Checker,
    ChromeSphere,
    Cork,
    Even,
    Gradient,
    Lens,
    Paint,
    Pattern,
    Print,
    Scene,
    Textile,
    Weave,
    Wood,
    bench_camera,
    bench_sensor,
    dome_lights,
    render,
)
from simulator._camera.sensor import sensor_image

Values = npt.NDArray[np.float32]
Array = npt.NDArray[np.float64]

# Width, height, and how often a size is drawn.
SIZES = (((640, 512), 0.5), ((960, 804), 0.3), ((1280, 1024), 0.15), ((2448, 2048), 0.05))
SMALL_SIZES = (((640, 512), 0.8), ((960, 804), 0.2))
RADII_MM = (8.0, 10.0, 12.0, 15.0, 18.0, 20.0, 25.0, 30.0)
SMALLEST_PX = 20.0
LONG_US, SHORT_US = 20000.0, 15.0
TOLERABLE_MM = 2.0


@dataclass(frozen=True, eq=False)
class Layout:
    """A rendered layout and its truth."""

    seed: int
    kind: str
    values: Values
    camera: CameraModel
    spheres: tuple[ChromeSphere, ...]
    lights_mm: Array

    def outlines(self) -> Iterator[tuple[ChromeSphere, Array]]:
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


@dataclass
class Score:
    """What was found in one layout."""

    seed: int
    kind: str
    wanted: int = 0
    found: int = 0
    missed: list[str] = field(default_factory=list)
    false: list[str] = field(default_factory=list)
    solvable: bool = False
    positions_mm: float = np.nan
    warnings: tuple[str, ...] = ()
    error: str = ""
    cpu_s: float = 0.0

    def line(self) -> str:
        """Return one line for people."""
        parts = [f"{self.seed} {self.kind}: {self.found}/{self.wanted} found"]
        if self.missed:
            parts.append("missed " + " ".join(self.missed))
        if self.false:
            parts.append("FALSE " + " ".join(self.false))
        if np.isfinite(self.positions_mm):
            parts.append(f"positions {self.positions_mm:.2f} mm")
        if self.warnings:
            parts.append("warned " + ",".join(self.warnings))
        if self.error:
            parts.append(self.error[:110])
        return "; ".join([*parts, f"{self.cpu_s:.1f} s"])


def outline(camera: CameraModel, sphere: ChromeSphere, count: int = 180) -> Array:
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
    pixels: Array = camera.project(camera.centre_mm + touch)
    return pixels


def radius_px(points: Array) -> float:
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
        lens=Lens.of(camera, sharp=False),
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


def record(scene: Scene, seed: int) -> Values:
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
        values: Values = np.load(place)
    else:
        values = record(scene, seed)
        if place is not None:
            np.save(place, values)
    lights_mm = np.asarray(scene.lights.positions_mm)
    return Layout(
        seed, kind, values, bench_camera(*scene.lens.size[::-1]), scene.spheres, lights_mm
    )


def judge(layout: Layout) -> Score:
    """Calibrate a layout and compare the result with the truth."""
    wanted = layout.wanted()
    score = Score(layout.seed, layout.kind, len(wanted), solvable=len(wanted) > 1)
    radii = [sphere.radius_mm for sphere in layout.spheres]
    same = len(set(radii)) == 1
    start = cpu_s()
    result: SphereCalibration | None = None
    try:
        result = calibrate_spheres(
            layout.values, camera=layout.camera, radius_mm=radii[0] if same else radii
        )
        outlines = [sphere.outline for sphere in result.spheres]
    except EstimateError as error:
        score.error = str(error)
    score.cpu_s = cpu_s() - start
    if result is None:
        outlines = [sphere.outline for sphere in find_spheres(layout.values)]
    else:
        score.warnings = tuple(warning.code for warning in result.warnings)
        if result.lights.positions_mm is not None:
            off = np.asarray(result.lights.positions_mm) - layout.lights_mm
            score.positions_mm = float(np.linalg.norm(off, axis=1).mean())
    _compare(layout, wanted, outlines, score)
    return score


def _compare(
    layout: Layout, wanted: list[ChromeSphere], outlines: list[Ellipse], score: Score
) -> None:
    """Count found, missed and false spheres."""
    left = list(outlines)
    for sphere, points in layout.outlines():
        centre, size = points.mean(axis=0), radius_px(points)
        near = [
            o
            for o in left
            if np.hypot(*(np.array(o.centre_px) - centre)) < 1 + 0.03 * size
            and abs(o.radius_px / size - 1) < 0.03 + 1 / size
        ]
        if near:
            left.remove(near[0])
            score.found += sphere in wanted
        elif sphere in wanted:
            score.missed.append(f"({centre[0]:.0f},{centre[1]:.0f},r{size:.0f})")
    score.false = [f"({o.centre_px[0]:.0f},{o.centre_px[1]:.0f},r{o.radius_px:.0f})" for o in left]


def cpu_s() -> float:
    """Return the CPU seconds of this process."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def summary(scores: list[Score]) -> str:
    """Return the figures of all layouts of one kind."""
    wanted, found = sum(s.wanted for s in scores), sum(s.found for s in scores)
    false = sum(len(s.false) for s in scores)
    solvable = [s for s in scores if s.solvable]
    quiet = [s for s in scores if np.isfinite(s.positions_mm) and not s.warnings]
    wrong = [s for s in quiet if s.positions_mm > TOLERABLE_MM]
    silent = [s for s in solvable if s in quiet]
    misses = [s.seed for s in scores if s.missed or s.false]
    median = np.median([s.positions_mm for s in quiet]) if quiet else np.nan
    return (
        f"{scores[0].kind}: {len(scores)} layouts, {found}/{wanted} found "
        f"({100 * found / max(wanted, 1):.1f} %), {false} false\n"
        f"  solvable {len(solvable)}, without warning {len(silent)} "
        f"({100 * len(silent) / max(len(solvable), 1):.0f} %); position sets without warning "
        f"{len(quiet)}, beyond {TOLERABLE_MM:g} mm {[s.seed for s in wrong]}, "
        f"median {median:.2f} mm\n"
        f"  seeds with a missed or a false sphere {misses}\n"
        f"  CPU {np.mean([s.cpu_s for s in scores]):.1f} s mean, "
        f"{max(s.cpu_s for s in scores):.1f} s most"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--board", choices=("plain", "patterned", "both"), default="both")
    parser.add_argument("--first", type=int, default=5000, help="first seed")
    parser.add_argument("--layouts", type=int, default=100, help="layouts of each kind")
    parser.add_argument("--small", action="store_true", help="images of at most 960 x 804 pixels")
    parser.add_argument("--cache", type=Path, help="folder that keeps rendered layouts")
    args = parser.parse_args()
    if args.cache is not None:
        args.cache.mkdir(parents=True, exist_ok=True)
    for kind in ("plain", "patterned") if args.board == "both" else (args.board,):
        scores = []
        for seed in range(args.first, args.first + args.layouts):
            layout = layout_of(seed, kind, small=args.small, cache=args.cache)
            scores.append(judge(layout))
            print(scores[-1].line())
            sys.stdout.flush()
        print(summary(scores))


if __name__ == "__main__":
    main()
