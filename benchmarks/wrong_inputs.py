"""Count the warnings about wrong radii, focal lengths and distortions, and false warnings.

The observations are those of `light_uncertainty.py`, with spheres on the plane (heights within 0.2
mm) and a highlight noise of 0.05 px. Each line has the shares of the seeds with a warning, with a
warning that names the wrong value (alone, or among other explanations), and with one that names
only others; then mean and scatter of the estimated change of the wrong value. One sphere gives
directions, which are not tested.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import light_uncertainty
import numpy as np
from harness import command_line

from acquisition import CameraModel, DataError
from calibration import EstimateError
from calibration.spheres.judge.input_tests import InputTest, check_inputs, doubtful
from calibration.spheres.outline.outline_noise import viewing_cone
from calibration.spheres.solve.joint_refinement import Observation, predicted_highlights
from calibration.spheres.solve.light_positions import locate_lights
from calibration.spheres.solve.sphere_positions import place

CASES = {
    "correct": ("", 0.0),
    "radius +1 %": ("ratio", 0.01),
    "radius +.5 %": ("ratio", 0.005),
    "radius +5 %": ("ratio", 0.05),
    "distance +1 %": ("distance", 0.01),
    "focal +1 %": ("focal", 0.01),
    "k1 = 0.1 ignored": ("distortion", 0.1),
    "k1 = -0.1 ignored": ("distortion", -0.1),
}


COUNTED = ("warned", "named", "alone", "wrongly", "refused")


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
    elif kind == "distance":
        real = replace(given, working_distance_mm=given.centre_mm[2] / (1 + size))
    elif kind == "distortion":
        real = replace(given, distortion=np.array([size, 0, 0, 0, 0]))
    layout = light_uncertainty.Layout("", count, (20.0,))
    centres, radii = light_uncertainty.spheres(layout, rng)
    centres = centres + [0, 0, 1] * rng.normal(0, 0.2, (count, 1))
    truth = light_uncertainty.dome()
    common_px = rng.normal(0, light_uncertainty.COMMON_PX)
    points = [
        light_uncertainty.outline_points(real, c, r, rng, common_px)
        for c, r in zip(centres, radii, strict=True)
    ]
    cones = [viewing_cone(given.rays(p), 1 / given.focal_px) for p in points]
    sigma_px = np.full((len(truth), count), 0.05)
    highlights = predicted_highlights(real, centres, radii, truth)
    highlights = highlights + rng.normal(0, 0.05, highlights.shape)
    stated = radii * (1 + size) if kind == "ratio" else radii
    placed = place(cones, stated, given)
    ids = tuple(f"L{i:02d}" for i in range(len(truth)))
    seen = Observation(given, placed, highlights, sigma_px)
    located = locate_lights(seen, ids)
    weights = np.where(located.used, sigma_px, np.inf)
    return check_inputs(replace(seen, sigma_px=weights), points, located.refined)


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--spheres", type=int, nargs="*", default=[2, 3, 4])
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=list(CASES))
    options = parser.parse_args()
    print("wrong value        spheres  warned  named  alone  wrongly  refused  change")
    for name in options.cases:
        kind, size = CASES[name]
        wrong = "ratio" if kind == "distance" else kind
        for count in options.spheres:
            counts: Counter[str] = Counter()
            changes = []
            for seed in range(options.first, options.first + options.seeds):
                try:
                    tests = trial(count, kind, size, seed)
                except (EstimateError, DataError):
                    counts["refused"] += 1
                    continue
                changes += [test.change for test in tests if test.name == wrong]
                named = [test.name for test in doubtful(tests)]
                counts["warned"] += bool(named)
                counts["named"] += wrong in named
                counts["alone"] += named == [wrong]
                counts["wrongly"] += bool(named) and wrong not in named
            shares = [100 * counts[one] / options.seeds for one in COUNTED]
            change = f"{np.mean(changes):+.4f} +- {np.std(changes):.4f}" if changes else ""
            text = "  ".join(f"{share:4.0f} %" for share in shares)
            print(f"{name:18} {count:7}  {text}  {change}", flush=True)


if __name__ == "__main__":
    main()
