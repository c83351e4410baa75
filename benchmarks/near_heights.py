"""Mean heights under near lights: their errors, and when ``height-doubtful`` appears.

Scenes of the simulator under 36 LEDs with shot noise, under the lights as they are, and under
lights that are all 10 mm too high or too low. Each figure is the height that was found minus the
true one in mm, with its stated standard deviation. A name such as ``coin+.3`` has a coat of that
roughness (GGX, F0 0.04). "normals" are mean errors in degrees under the lights as they are, at the
points that were found and, after "of", at the true ones. Seeds 0 to 3 were used for development.

    python benchmarks/near_heights.py --first-seed 101 --seeds 3
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from harness import command_line

from acquisition import Lights
from processing import Method, angular_error, photometric_stereo
from processing.images.viewing_rays import Perspective
from processing.near.near_height import near_height
from rig.arrays import AnyArray, Float32
from simulator import Rendering, Truth, render, scene_named
from simulator.scene import Ggx

SCENES = (
    "coin", "tilted-plane", "sphere", "scales", "woodcarving", "leather", "plane", "step-gauge",
    "coin+.3", "coin+.15", "sphere+.3",
)  # fmt: skip
PHOTONS = 10_000
METHODS: tuple[Method, ...] = ("ls", "cauchy", "best")


def rendered(name: str, seed: int, size: tuple[int, int], leds: int) -> Rendering:
    kind, _, gloss = name.partition("+")
    scene = scene_named(kind, width=size[0], height=size[1], leds=leds, seed=seed)
    scene = replace(scene, ambient=0.0)
    return render(replace(scene, material=Ggx(float(gloss), 0.04)) if gloss else scene)


def images(rendering: Rendering, seed: int) -> Float32:
    """Return noisy images, divided by the strengths of the lights, NaN where saturated."""
    truth, planes = rendering.truth, rendering.planes
    if planes.ndim == 4:
        planes = planes.mean(axis=-1)
    full = np.quantile(planes[:, truth.mask], 0.999) / 0.8
    rng = np.random.default_rng([seed, 1])
    counted = rng.poisson(PHOTONS * np.clip(planes / full, 0, 1)) / PHOTONS
    strengths = np.asarray(truth.lights.intensities).mean(axis=1)
    measured = np.where(counted < 1, counted, np.nan)
    return np.asarray(measured / strengths[:, None, None], np.float32)


def error_deg(values: Float32, truth: Truth, depth: AnyArray, method: Method) -> float:
    """Return the mean error of normals for which the surface is at a depth, mm."""
    if truth.camera is None:
        raise SystemExit("the scene has no camera")
    points = truth.camera.points_at(np.where(truth.mask, depth, np.median(depth[truth.mask])))
    solved = photometric_stereo(
        values, truth.lights, truth.mask, method=method, points_mm=points, camera=truth.camera
    )
    return angular_error(solved.normal_map, truth.normals, truth.mask).mae_deg


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--first-seed", type=int, default=101, help="first seed of the scenes")
    parser.add_argument("--seeds", type=int, default=1, help="number of seeds")
    parser.add_argument("--leds", type=int, default=36, help="number of LEDs")
    parser.add_argument("--size", type=int, nargs=2, default=(240, 200), help="width and height")
    parser.add_argument("--shift-mm", type=float, default=10.0, help="shift of all lights")
    parser.add_argument("--scenes", nargs="*", default=list(SCENES), help="scenes")
    options = parser.parse_args()
    shifts = {"as they are": 0.0, "higher": options.shift_mm, "lower": -options.shift_mm}
    doubtful = dict.fromkeys(shifts, 0)
    count = 0
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        for name in options.scenes:
            made = rendered(name, seed, tuple(options.size), options.leds)
            truth, values = made.truth, images(made, seed)
            if truth.camera is None:
                raise SystemExit(f"{name} has no camera")
            view = Perspective(truth.camera)
            true_mm = float(np.nanmean(truth.height_mm[truth.mask]))
            row, depths = [], {}
            for label, shift in shifts.items():
                lights = Lights(
                    positions_mm=truth.lights.positions_mm + np.array([0, 0, shift]),
                    axes=truth.lights.axes,
                    mu=truth.lights.mu,
                )
                found = near_height(values, lights, truth.mask, view)
                named = any(notice.code == "height-doubtful" for notice in found.warnings)
                doubtful[label] += named and "+" not in name
                off, sigma = found.mean_height_mm - true_mm, found.mean_height_sigma_mm
                row.append(f"{off:7.2f} +- {sigma:.2f} {'doubtful' if named else '':8}")
                depths[label] = found.depth
            count += "+" not in name
            print(f"{seed:4d} {name:13}", *row, flush=True)
            cells = []
            for method in METHODS:
                at_found = error_deg(values, truth, depths["as they are"], method)
                at_truth = error_deg(values, truth, truth.depth_mm, method)
                cells.append(
                    f"{method} {at_found:.3f} of {at_truth:.3f} ({at_found / at_truth:.2f})"
                )
            print(f"{'':5}normals", *cells, flush=True)
    print(f"doubtful of {count} matte scenes:", ", ".join(f"{k} {v}" for k, v in doubtful.items()))


if __name__ == "__main__":
    main()
