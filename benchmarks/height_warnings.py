"""Notices about mean heights under near lights, gloss and strengths, found and missed.

Scenes of the simulator under 36 LEDs with shot noise, of matte surfaces and of some with a coat.
Each row counts the recordings in which a notice appears: rows of what is right should have 0.
Seeds 0 to 2 were used for development.

    python benchmarks/height_warnings.py --first-seed 201 --seeds 2
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from harness import command_line
from near_heights import images, rendered

from acquisition import Lights
from calibration import EstimateError
from processing import photometric_stereo
from processing.images.viewing_rays import Perspective
from processing.near import NearHeight
from processing.near.near_height import near_height
from processing.noise import normal_uncertainty
from processing.noise.normal_errors import STRUCTURED
from processing.series import light_strengths

MATTE = (
    "coin", "tilted-plane", "sphere", "scales", "woodcarving", "leather", "textile", "plane",
    "step-gauge",
)  # fmt: skip
# The number is the roughness of the coat.
GLOSSY = ("coin+.3", "coin+.15", "sphere+.3", "scales+.5", "woodcarving+.3")
SHIFT_MM, STATED_MM = 10.0, 6.0
# Standard deviation of independent errors of the positions of the lights, which are not stated.
LIGHTS_MM = 1.0
# An object whose lowest point is below this height rests on the working plane.
RESTS_MM = 1.0


def rows_of(
    name: str, seed: int, size: tuple[int, int], leds: int
) -> dict[str, Callable[[], bool | None]]:
    """Return the rows of the table; each function returns whether the notice appears.

    It returns None if the row is impossible for this scene.
    """
    made = rendered(name, seed, size, leds)
    truth, values = made.truth, images(made, seed)
    positions = truth.lights.positions_mm
    if truth.camera is None or positions is None:
        raise SystemExit(f"{name} has no camera or no near lights")
    view, mask = Perspective(truth.camera), truth.mask
    # The images are divided by the strengths.
    lights = Lights(positions_mm=positions, axes=truth.lights.axes, mu=truth.lights.mu)
    heights = truth.height_mm[mask]
    true_mm = float(np.nanmean(heights))

    def has(code: str, found: NearHeight) -> bool:
        return any(notice.code == code for notice in found.warnings)

    def doubtful(shift_mm: float) -> bool:
        moved = replace(lights, positions_mm=positions + np.array([0, 0, shift_mm]))
        return has("height-doubtful", near_height(values, moved, mask, view, method="cauchy"))

    def contradicted(off_mm: float, lights: Lights = lights) -> bool:
        stated = true_mm + off_mm
        found = near_height(values, lights, mask, view, method="cauchy", height_mm=stated)
        return has("height-contradicted", found)

    def contradicted_under_wrong_lights() -> bool:
        off = np.random.default_rng([seed, 2]).normal(0, LIGHTS_MM, positions.shape)
        return contradicted(0.0, replace(lights, positions_mm=positions + off))

    def does_not_rest() -> bool | None:
        if float(np.nanmin(heights)) > RESTS_MM:
            return None
        found = near_height(values, lights, mask, view, method="cauchy", rests_on_plane=True)
        return has("height-contradicted", found)

    def not_matte() -> bool:
        near = near_height(values, lights, mask, view, method="cauchy")
        points = view.points_at(near.depth)
        stereo = photometric_stereo(values, lights, mask, method="cauchy", points_mm=points)
        sure = normal_uncertainty(values, lights, mask, stereo, points_mm=points)
        return sure.neighbour_correlation > STRUCTURED

    def strengths_not_matte() -> bool | None:
        try:
            strengths = light_strengths(values, lights, mask, points_mm=truth.points_mm)
        except EstimateError:
            return None
        return any(notice.code == "strengths-not-matte" for notice in strengths.warnings)

    return {
        "height-doubtful, right lights": lambda: doubtful(0.0),
        f"height-doubtful, all lights +{SHIFT_MM:.0f} mm": lambda: doubtful(SHIFT_MM),
        f"height-doubtful, all lights -{SHIFT_MM:.0f} mm": lambda: doubtful(-SHIFT_MM),
        "height-contradicted, right height": lambda: contradicted(0.0),
        f"height-contradicted, right, lights +-{LIGHTS_MM:.0f} mm": contradicted_under_wrong_lights,
        f"height-contradicted, stated +{STATED_MM:.0f} mm": lambda: contradicted(STATED_MM),
        f"height-contradicted, stated -{STATED_MM:.0f} mm": lambda: contradicted(-STATED_MM),
        "height-contradicted, rests on plane": does_not_rest,
        "surface-not-matte": not_matte,
        "strengths-not-matte": strengths_not_matte,
    }


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--first-seed", type=int, default=201, help="first seed of the scenes")
    parser.add_argument("--seeds", type=int, default=1, help="number of seeds")
    parser.add_argument("--leds", type=int, default=36, help="number of LEDs")
    parser.add_argument("--size", type=int, nargs=2, default=(160, 128), help="width and height")
    parser.add_argument("--only", default="", help="only rows that contain this text")
    options = parser.parse_args()
    counts: dict[str, list[bool]] = {}
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        for name in (*MATTE, *GLOSSY):
            kind = "coat" if "+" in name else "matte"
            for row, appears in rows_of(name, seed, tuple(options.size), options.leds).items():
                found = appears() if options.only in row else None
                if found is None:
                    continue
                print(f"{seed:4d} {name:14} {row:<40} {'named' if found else '-'}", flush=True)
                counts.setdefault(f"{kind:<6} {row:<40}", []).append(found)
    for row, named in counts.items():
        print(f"{row} {sum(named):4d} of {len(named)}")


if __name__ == "__main__":
    main()
