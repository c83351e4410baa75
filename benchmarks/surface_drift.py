"""Flatness of a reference plane and heights of known steps, with one source of error at a time.

The plane and the gauge are recorded on the simulated rig and go through photometric stereo and
integration, as in ``sgp run``. The gauge is a staircase with ramps, because normals do not show a
vertical wall. "bend" is the deviation of the plane from the plane that fits it best, as rms and as
the range between the 1st and the 99th percentile; "tilt" is the angle to the true one. The errors
of steps are those of the differences between the means of neighbouring treads. Errors of lights are
drawn for several seeds; their rows have the rms over the seeds.

    python benchmarks/surface_drift.py
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from harness import command_line

import acquisition
import processing
import simulator
from rig.arrays import Bool, Float64

HEIGHTS_MM = (1.0, 2.0, 4.0, 8.0)
RAMP_MM = 14.0
RADIUS_MM = 80.0


@dataclass(frozen=True)
class Case:
    """One source of error: how lights are changed, and options of `processing.reconstruct`."""

    name: str
    change: Callable[[acquisition.Lights, np.random.Generator], acquisition.Lights] | None = None
    noise: bool = True
    distant: bool = False
    # Error of the stated mean height, in mm; None: the height is estimated.
    off_mm: float | None = None


def moved(mm: float, *, common: bool = False) -> Callable[..., acquisition.Lights]:
    """Return a change of the positions, of each light or of all lights together."""

    def change(lights: acquisition.Lights, rng: np.random.Generator) -> acquisition.Lights:
        positions = np.asarray(lights.positions_mm)
        shift = rng.normal(0, mm, (1 if common else len(lights), 3))
        return replace(lights, positions_mm=positions + shift)

    return change


def brightened(share: float) -> Callable[..., acquisition.Lights]:
    def change(lights: acquisition.Lights, rng: np.random.Generator) -> acquisition.Lights:
        factors = 1 + rng.normal(0, share, np.shape(lights.intensities))
        return replace(lights, intensities=lights.intensities * factors)

    return change


CASES = (
    Case("none: no noise, true lights", noise=False),
    Case("noise of the sensor"),
    Case("each light 0.5 mm off", moved(0.5), noise=False),
    Case("each light 2 mm off", moved(2.0), noise=False),
    Case("all lights 2 mm off together", moved(2.0, common=True), noise=False),
    Case("intensities 0.5 % off", brightened(0.005), noise=False),
    Case("mean height 2 mm too high", noise=False, off_mm=2.0),
    Case("mean height 10 mm too high", noise=False, off_mm=10.0),
    Case("near lights taken as distant", noise=False, distant=True),
)


def scenes(width: int, height: int) -> dict[str, simulator.Scene]:
    """Return the plane and the gauge on the bench."""
    plane = simulator.scene_named("plane", width=width, height=height)
    plane = replace(plane, pattern=simulator.shapes.Even(0.6))
    gauge = replace(plane, body=simulator.shapes.StepGauge(RADIUS_MM, HEIGHTS_MM, RAMP_MM))
    return {"plane": plane, "gauge": gauge}


def surface_of(folder: Path, case: Case, truth: Float64, seed: int) -> tuple[Float64, Bool]:
    """Return the points of a surface and its mask."""
    stored = folder / "derived" / "truth"
    lights = acquisition.read_lights(stored / "lights.json")
    if case.change is not None:
        lights = case.change(lights, np.random.default_rng(seed))
    source = acquisition.read_source(
        folder, lights=lights, camera=acquisition.read_camera(stored / "camera.json")
    )
    height = None if case.off_mm is None else float(np.nanmean(truth)) + case.off_mm
    found = processing.reconstruct(source, distant=case.distant, height_mm=height)
    if found.surface is None:
        raise ValueError("the surface was not requested")
    return found.surface.points().astype(np.float64), found.surface.mask


def plane_figures(points: Float64, mask: Bool, truth: Float64) -> list[float]:
    """Return bend (rms and range) in micrometres, and tilt in degrees."""
    inside = mask & np.isfinite(truth)
    x, y, z = points[inside].T
    A = np.stack([x, y, np.ones_like(x)], axis=1)
    fitted = np.linalg.lstsq(A, z, rcond=None)[0]
    true = np.linalg.lstsq(A, truth[inside], rcond=None)[0]
    off = z - A @ fitted
    tilt = np.degrees(np.arctan(np.hypot(*(fitted - true)[:2])))
    low, high = np.quantile(off, [0.01, 0.99])
    return [1000 * float(off.std()), 1000 * float(high - low), float(tilt)]


def step_figures(points: Float64, mask: Bool, truth: Float64) -> list[float]:
    """Return the error of each step in micrometres, along the middle of the gauge."""
    gauge = simulator.shapes.StepGauge(RADIUS_MM, HEIGHTS_MM, RAMP_MM)
    ends = np.concatenate([[-np.inf], gauge.edges_mm, [np.inf]])
    outer = 0.5 * gauge.tread_mm * len(HEIGHTS_MM)
    inside = mask & np.isfinite(truth) & (np.abs(points[..., 1]) < 0.25 * RADIUS_MM)
    levels = []
    for left, right in pairwise(ends):
        flat = inside & (points[..., 0] > max(left, -outer) + 0.5 * RAMP_MM + 1)
        flat &= points[..., 0] < min(right, outer) - 0.5 * RAMP_MM - 1
        levels.append((points[..., 2] - truth)[flat].mean())
    return [1000 * float(error) for error in np.diff(levels)]


def recorded(scene: simulator.Scene, folder: Path, name: str, *, noise: bool) -> Path:
    """Record a scene as ``sgp simulate`` does, and return the folder of the session."""
    from sgp.commands.simulate import simulate

    simulator.write_scene(folder / f"{name}.toml", scene)
    out = folder / f"{name}-{'noise' if noise else 'clean'}"
    simulate(str(folder / f"{name}.toml"), out=out, noise=noise)
    return out


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--size", type=int, nargs=2, default=[320, 256], help="pixels of the image")
    parser.add_argument("--seeds", type=int, default=5, help="seeds of the errors of lights")
    parser.add_argument("--first-seed", type=int, default=100, help="the first of them")
    options = parser.parse_args()
    steps = " ".join(f"{rise:5.0f} mm" for rise in np.diff(HEIGHTS_MM))
    print(
        f"{'error':30} {'bend rms, um':>12} {'range, um':>9} {'tilt, deg':>9}   steps, um: {steps}"
    )
    with tempfile.TemporaryDirectory() as place:
        folders = {
            (name, noise): recorded(scene, Path(place), name, noise=noise)
            for name, scene in scenes(*options.size).items()
            for noise in (False, True)
        }
        for case in CASES:
            seeds = options.seeds if case.change is not None else 1
            rows = []
            for seed in range(options.first_seed, options.first_seed + seeds):
                row = []
                for name, figures in (("plane", plane_figures), ("gauge", step_figures)):
                    folder = folders[name, case.noise]
                    path = folder / "derived" / "truth" / "height.exr"
                    truth = acquisition.read_image(path).astype(np.float64)
                    points, mask = surface_of(folder, case, truth, seed)
                    row += figures(points, mask, truth)
                rows.append(row)
            # One seed keeps the signs of the steps.
            means = np.sqrt(np.square(rows).mean(axis=0)) if seeds > 1 else np.array(rows[0])
            print(
                f"{case.name:30} {means[0]:12.1f} {means[1]:9.1f} {means[2]:9.3f}   "
                + " " * 11
                + " ".join(f"{error:8.1f}" for error in means[3:]),
                flush=True,
            )


if __name__ == "__main__":
    main()
