"""Notices about mean heights under near lights, gloss and strengths, found and missed.

Scenes of the simulator under 36 LEDs with shot noise, of matte surfaces and of some with a coat.
Each row counts the recordings in which a notice appears: rows of what is right should have 0.
Seeds 0 to 2 were used for development.

    python benchmarks/height_warnings.py --first-seed 201 --seeds 2
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from harness import command_line
from near_heights import images, rendered

from acquisition import Lights
from calibration import EstimateError
from processing import light_strengths, normal_uncertainty, photometric_stereo
from processing._reconstruction.near_height import NearHeight, near_height
from processing._reconstruction.views import Perspective
from processing._uncertainty.normal_uncertainty import STRUCTURED

MATTE = (
    "coin", "tilted-plane", "sphere", "scales", "woodcarving", "leather", "textile", "plane",
    "step-gauge",
)  # fmt: skip
# The number is the roughness of the coat.
GLOSSY = ("coin+.3", "coin+.15", "sphere+.3", "scales+.5", "woodcarving+.3")
SHIFT_MM, STATED_MM = 10.0, 6.0
# An object whose lowest point is below this height rests on the working plane.
RESTS_MM = 1.0


def notices(name: str, seed: int, size: tuple[int, int], leds: int) -> Iterator[tuple[str, bool]]:
    """Yield rows of the table, and whether the notice appears."""
    made = rendered(name, seed, size, leds)
    truth, values = made.truth, images(made, seed)
    if truth.camera is None or truth.lights.positions_mm is None:
        raise SystemExit(f"{name} has no camera or no near lights")
    view, mask = Perspective(truth.camera), truth.mask
    # The images are divided by the strengths.
    lights = Lights(
        positions_mm=truth.lights.positions_mm, axes=truth.lights.axes, mu=truth.lights.mu
    )
    heights = truth.height_mm[mask]
    true_mm = float(np.nanmean(heights))

    near = near_height(values, lights, mask, view, method="cauchy")
    yield "height-doubtful, right lights", _has(near, "height-doubtful")
    for shift in (SHIFT_MM, -SHIFT_MM):
        moved = replace(lights, positions_mm=truth.lights.positions_mm + np.array([0, 0, shift]))
        found = near_height(values, moved, mask, view, method="cauchy")
        yield f"height-doubtful, all lights {shift:+.0f} mm", _has(found, "height-doubtful")
    for off in (0.0, STATED_MM, -STATED_MM):
        found = near_height(values, lights, mask, view, method="cauchy", height_mm=true_mm + off)
        yield f"height-contradicted, stated {off:+.0f} mm", _has(found, "height-contradicted")
    if float(np.nanmin(heights)) < RESTS_MM:
        found = near_height(values, lights, mask, view, method="cauchy", rests_on_plane=True)
        yield "height-contradicted, rests on plane", _has(found, "height-contradicted")

    points = view.points_at(near.depth)
    stereo = photometric_stereo(values, lights, mask, method="cauchy", points_mm=points)
    sure = normal_uncertainty(values, lights, mask, stereo, points_mm=points)
    yield "surface-not-matte", sure.neighbour_correlation > STRUCTURED
    try:
        strengths = light_strengths(values, lights, mask, points_mm=truth.points_mm)
    except EstimateError:
        return
    codes = [notice.code for notice in strengths.warnings]
    yield "strengths-not-matte", "strengths-not-matte" in codes


def _has(found: NearHeight, code: str) -> bool:
    return any(notice.code == code for notice in found.warnings)


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--first-seed", type=int, default=201, help="first seed of the scenes")
    parser.add_argument("--seeds", type=int, default=1, help="number of seeds")
    parser.add_argument("--leds", type=int, default=36, help="number of LEDs")
    parser.add_argument("--size", type=int, nargs=2, default=(160, 128), help="width and height")
    options = parser.parse_args()
    for title, names in (("matte", MATTE), ("with a coat", GLOSSY)):
        counts: dict[str, list[str]] = {}
        total: dict[str, int] = {}
        for seed in range(options.first_seed, options.first_seed + options.seeds):
            for name in names:
                for row, appears in notices(name, seed, tuple(options.size), options.leds):
                    total[row] = total.get(row, 0) + 1
                    counts.setdefault(row, []).extend([f"{name} {seed}"] * appears)
        for row, named in counts.items():
            which = f" ({', '.join(named)})" if len(named) < total[row] / 2 else ""
            print(f"{title:<12} {row:<40}{len(named):>4} of {total[row]}{which}", flush=True)


if __name__ == "__main__":
    main()
