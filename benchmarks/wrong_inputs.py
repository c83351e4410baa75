"""Count the warnings about wrong radii, focal lengths and distortions, and false warnings.

The observations are those of `light_uncertainty.py`, with spheres on the plane (heights within 0.2
mm) and a highlight noise of 0.05 px. Each line has the share of the seeds with a warning, how often
each value explained the data best, and mean and scatter of the estimated change of the wrong value.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import light_uncertainty
import numpy as np
from harness import command_line

from acquisition import CameraModel, DataError
from calibration import EstimateError
from calibration._spheres.input_tests import InputTest, check_inputs, doubts
from calibration._spheres.joint_refinement import predicted_highlights
from calibration._spheres.light_positions import locate_lights
from calibration._spheres.outline_noise import viewing_cone
from calibration._spheres.placed import place

CASES = {
    "correct": ("", 0.0),
    "radius +1 %": ("ratio", 0.01),
    "radius +.5 %": ("ratio", 0.005),
    "focal +1 %": ("focal", 0.01),
    "k1 = .1 ignored": ("distortion", 0.1),
    "k1 = -.1 ignored": ("distortion", -0.1),
}


def trial(count: int, kind: str, size: float, seed: int) -> list[InputTest]:
    """Return the tests of a seed with one wrong given value."""
    rng = np.random.default_rng(seed)
    given = light_uncertainty.camera()
    real: CameraModel = given
    if kind == "focal":
        K = given.K.copy()
        K[0, 0] /= 1 + size
        K[1, 1] /= 1 + size
        real = replace(given, K=K)
    elif kind == "distortion":
        real = replace(given, distortion=np.array([size, 0, 0, 0, 0]))
    layout = light_uncertainty.Layout("", count, (20.0,))
    centres, radii = light_uncertainty.spheres(layout, rng)
    centres = centres + [0, 0, 1] * rng.normal(0, 0.2, (count, 1))
    truth = light_uncertainty.dome()
    points = [
        light_uncertainty.outline_points(real, c, r, rng)
        for c, r in zip(centres, radii, strict=True)
    ]
    cones = [viewing_cone(given.rays(p), 1 / given.focal_px) for p in points]
    sigma_px = np.full((len(truth), count), 0.05)
    highlights = predicted_highlights(real, centres, radii, truth)
    highlights = highlights + rng.normal(0, 0.05, highlights.shape)
    stated = radii * (1 + size) if kind == "ratio" else radii
    placed = place(cones, stated, given)
    ids = tuple(f"L{i:02d}" for i in range(len(truth)))
    located = locate_lights(given, placed, highlights, sigma_px, ids)
    weights = np.where(located.used, sigma_px, np.inf)
    return check_inputs(given, placed, points, located.refined, highlights, weights)


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--spheres", type=int, nargs="*", default=[2, 3, 4])
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=list(CASES))
    options = parser.parse_args()
    given = light_uncertainty.camera()
    for name in options.cases:
        kind, size = CASES[name]
        for count in options.spheres:
            named: Counter[str] = Counter()
            changes = []
            warned = 0
            for seed in range(options.first, options.first + options.seeds):
                try:
                    tests = trial(count, kind, size, seed)
                except (EstimateError, DataError):
                    named["refused"] += 1
                    continue
                own = [test for test in tests if test.name == kind]
                changes += [test.change for test in own]
                if doubts(tests, given, np.full(count, 20.0)):
                    warned += 1
                    named[tests[0].name] += 1
            share = 100 * warned / options.seeds
            change = f"{np.mean(changes):+.4f} +- {np.std(changes):.4f}" if changes else ""
            print(f"{name:18} {count} spheres {share:5.1f} %  {dict(named)}  {change}")


if __name__ == "__main__":
    main()
