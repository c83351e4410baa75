"""Errors of lights from rendered chrome spheres: seen with the blur of a lens, found or masked.

Each seed renders 36 LEDs at 450 mm over a card with chrome spheres, 12 bits, two exposures: two
spheres near opposite corners or four near all corners, each moved by up to 12 mm. The camera has f
5000 px and 2448 x 2048 px at 600 mm; `--size` gives the same field other pixels. The spheres are
searched for, and marked by the masks of the truth. The columns are the mean error of the positions
in mm and of the directions from the middle of the field in degrees, the squared errors along X, Y
and Z relative to their stated variances, the largest of the 36 lights in standard deviations, the
errors of the outline radii in px (mean and scatter between the spheres) and of each coordinate of
their centres (rms), and the codes of warnings. 36 images of 5 Mpx are rendered in 30 CPU s.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from harness import command_line
from light_uncertainty import camera, outline_points
from sphere_setups import CORNERS, Exact, smaller

from acquisition import CameraModel, angle_deg
from calibration import EstimateError, SphereCalibration, calibrate_spheres
from calibration.spheres import fit_ellipse
from rig.arrays import Float32, Float64
from simulator import ChromeSphere, Lens, Scene, Truth, bench_sensor, dome_lights, render
from simulator.camera import sensor_image
from simulator.shapes import Even

LONG_US, SHORT_US = 20000.0, 40.0
# Largest mean errors that are accepted at full size, by the number of spheres.
BARS = {2: (0.6, 0.03), 4: (0.4, 0.02)}


@dataclass(frozen=True)
class Score:
    """Errors of one calibration."""

    error_mm: float
    error_deg: float
    shares: Float64
    worst_sigmas: float
    radii_px: Float64
    centres_px: Float64
    codes: tuple[str, ...]


def scene_of(seed: int, count: int, model: CameraModel, *, sharp: bool) -> Scene:
    """Draw spheres near the corners, and the lights of a dome."""
    rng = np.random.default_rng([seed, count])
    places = 0.9 * np.array(CORNERS[:count]) + rng.uniform(-12, 12, (count, 2))
    return Scene(
        body=None,
        lights=dome_lights(36, seed=seed),
        lens=Lens(model, sharp=sharp),
        noise=bench_sensor(),
        electrons_per_us=0.42,
        board=Even(0.4),
        spheres=tuple(ChromeSphere((x, y, 20.0), 20.0) for x, y in places.tolist()),
    )


def record(scene: Scene, seed: int) -> tuple[Float32, Truth]:
    """Render a scene and merge two exposures of each image; NaN where both are saturated."""
    rendering, noise = render(scene), scene.noise
    span = noise.white_level_dn - noise.black_level_dn
    # The image of an LED has the same photons on more pixels.
    exposures = (LONG_US, SHORT_US * (640 / scene.lens.size[1]) ** 2)
    values = np.full(rendering.planes.shape, np.nan, np.float32)
    for led, plane in enumerate(rendering.planes):
        for bracket, exposure_us in enumerate(exposures):
            electrons = ((plane + rendering.ambient) * exposure_us).astype(np.float32)
            dn = sensor_image(electrons, noise, key=(seed, led, bracket)).astype(np.float32)
            sample = (dn - noise.black_level_dn) / span * LONG_US / exposure_us
            sample[dn >= noise.white_level_dn] = np.nan
            values[led] = np.where(np.isnan(values[led]), sample, values[led])
    return values, rendering.truth


def judge(estimate: SphereCalibration, truth: Truth) -> Score:
    """Compare a calibration with the truth."""
    right = truth.lights
    off = np.asarray(estimate.lights.positions_mm) - np.asarray(right.positions_mm)
    angle = angle_deg(estimate.lights.unit_directions, right.unit_directions)
    covariance = np.asarray(estimate.lights.errors and estimate.lights.errors.covariances)
    solved = np.linalg.solve(covariance, off[..., None])[..., 0]
    shifts, sizes = [], []
    for sphere in estimate.spheres:
        ellipses = [
            fit_ellipse(outline_points(truth.camera, centre, float(radius), Exact()))[0]
            for centre, radius in zip(truth.sphere_centres_mm, truth.sphere_radii_mm, strict=True)
        ]
        gaps = [np.subtract(sphere.outline.centre_px, e.centre_px) for e in ellipses]
        nearest = int(np.argmin(np.linalg.norm(gaps, axis=1)))
        shifts.append(gaps[nearest])
        sizes.append(sphere.outline.radius_px - ellipses[nearest].radius_px)
    return Score(
        float(np.linalg.norm(off, axis=1).mean()),
        float(angle.mean()),
        np.mean(off**2 / np.diagonal(covariance, axis1=1, axis2=2), axis=0),
        float(np.sqrt(np.max(np.sum(off * solved, axis=1)))),
        np.array(sizes),
        np.array(shifts),
        tuple(notice.code for notice in estimate.warnings),
    )


def line(score: Score) -> str:
    x, y, z = score.shares
    return (
        f"{score.error_mm:6.2f} mm {score.error_deg:6.3f} deg   chi2 {x:5.2f} {y:5.2f} {z:5.2f}   "
        f"worst {score.worst_sigmas:4.1f} sigma   outlines {score.radii_px.mean():+.3f} +- "
        f"{score.radii_px.std(ddof=1):.3f} px radius, {np.sqrt(np.mean(score.centres_px**2)):.3f} "
        f"px centre   {' '.join(score.codes)}"
    )


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--spheres", type=int, nargs="*", default=[2, 4], choices=[2, 3, 4])
    parser.add_argument("--size", type=float, default=1.0, help="share of 2448 x 2048 pixels")
    parser.add_argument("--marks", nargs="*", default=["found", "masks"])
    parser.add_argument("--sharp", action="store_true", help="without the blur of the lens")
    options = parser.parse_args()
    model = smaller(camera(), options.size)
    scores: dict[tuple[int, str], list[Score]] = {}
    for seed in range(options.first, options.first + options.seeds):
        for count in options.spheres:
            start = time.process_time()
            values, truth = record(scene_of(seed, count, model, sharp=options.sharp), seed)
            print(
                f"seed {seed}, {count} x R20: rendered in {time.process_time() - start:.0f} CPU s"
            )
            for marks in options.marks:
                start = time.process_time()
                masks = list(truth.sphere_masks) if marks == "masks" else None
                try:
                    estimate = calibrate_spheres(
                        values, masks=masks, camera=truth.camera, radius_mm=20.0
                    )
                except EstimateError as error:
                    print(f"  {marks:6} refused: {error}")
                    continue
                score = judge(estimate, truth)
                scores.setdefault((count, marks), []).append(score)
                print(f"  {marks:6} {line(score)}  {time.process_time() - start:.0f} CPU s")
    print("mean of the seeds; outlines: radius common to a seed, own radius, centre (rms, px)")
    for (count, marks), all_of in scores.items():
        x, y, z = np.mean([score.shares for score in all_of], axis=0)
        mm = np.mean([score.error_mm for score in all_of])
        deg = np.mean([score.error_deg for score in all_of])
        means = np.array([score.radii_px.mean() for score in all_of])
        own = np.sqrt(np.mean([score.radii_px.var(ddof=1) for score in all_of]))
        centre = np.sqrt(np.mean([np.mean(score.centres_px**2) for score in all_of]))
        bars = BARS.get(count)
        limit = f"(bars {bars[0]} mm, {bars[1]} deg)" if bars and options.size == 1 else ""
        print(
            f"  {count} x R20 {marks:6} {mm:6.2f} mm {deg:6.3f} deg   chi2 {x:5.2f} {y:5.2f} "
            f"{z:5.2f}   outlines {means.mean():+.3f} +- {means.std():.3f}, {own:.3f}, "
            f"{centre:.3f} {limit}"
        )


if __name__ == "__main__":
    main()
