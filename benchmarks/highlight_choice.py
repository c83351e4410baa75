"""Positions of lights from images with other bright spots on the spheres than their highlights.

Each seed renders two and four chrome spheres of R20 at 612 x 512 px under 36 LEDs at 450 mm, and
draws spots of the size of a highlight into the images:

- plain: none;
- lamp: a lamp three times as bright as the LEDs, which shines under 40 % of them;
- ghost: on one sphere, a spot with 0.8 or twice the flux of the highlight, under six lights;
- second: under six lights, the highlight on one sphere is hidden, and the sphere shows the light as
  another sphere mirrors it (two reflections), with half of the flux.

Unsaturated highlights are those of two exposures; saturated ones are clipped at a tenth of their
peaks. The columns are the mean error of the positions in mm, the number of lights that are not
named although they are off by 2 mm more than in plain images, the number that are named, also of
those that are not off, and the calibrations that were refused. Lower seeds than 1000 were used to
choose constants.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from harness import command_line
from light_accuracy import record, scene_of
from light_uncertainty import camera
from sphere_setups import smaller

from acquisition import CameraModel
from calibration import EstimateError, calibrate_spheres
from calibration.spheres.geometry.reflection import mirror_points
from rig.arrays import Float32, Float64
from simulator import Truth

KINDS = ("plain", "lamp", "ghost 0.8", "ghost 2", "second")
SIGMA_PX, ERASED_PX = 0.9, 7
AFFECTED = 6
WRONG_MM = 2.0


@dataclass
class Score:
    """Sums over the seeds."""

    errors_mm: list[float] = field(default_factory=list)
    silent: int = 0
    false: int = 0
    named: int = 0
    refused: list[str] = field(default_factory=list)


def disturbed(kind: str, values: Float32, truth: Truth, seed: int) -> Float32:
    """Return the images with other bright spots."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    values = values.copy()
    model, centres = truth.camera, np.asarray(truth.sphere_centres_mm, np.float64)
    radii = np.asarray(truth.sphere_radii_mm, np.float64)
    lights = np.asarray(truth.lights.positions_mm)
    spots = np.asarray(truth.highlights_px)
    if kind == "lamp":
        turn, tilt = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(30, 70))
        flat = np.cos(tilt)
        lamp = 700 * np.array([flat * np.cos(turn), flat * np.sin(turn), np.sin(tilt)])
        for k, place in enumerate(
            model.project(mirror_points(model.centre_mm, lamp, centres, radii))
        ):
            for n in range(round(0.6 * len(values)), len(values)):
                add(values[n], place, 3 * peak(values[n], spots[k, n]))
        return values
    if kind == "plain":
        return values
    k = int(rng.integers(len(centres)))
    median = np.median(values, axis=0)
    for n in rng.choice(len(values), AFFECTED, replace=False):
        brightness = peak(values[n], spots[k, n])
        if kind == "second":
            other = int(rng.choice([j for j in range(len(centres)) if j != k]))
            place = twice_mirrored(model, lights[n], centres[[k, other]], radii[[k, other]])
            x, y = np.rint(spots[k, n]).astype(int)
            hidden = np.s_[y - ERASED_PX : y + ERASED_PX + 1, x - ERASED_PX : x + ERASED_PX + 1]
            values[n][hidden] = median[hidden]
            add(values[n], place, 0.5 * brightness)
            continue
        radius_px = model.focal_px * radii[k] / model.centre_mm[2]
        middle = model.project(centres[k])
        while True:
            place = middle + radius_px * rng.uniform(-0.7, 0.7, 2)
            apart = np.linalg.norm(place - spots[k, n]) > 0.25 * radius_px
            if apart and np.linalg.norm(place - middle) < 0.7 * radius_px:
                break
        add(values[n], place, float(kind.split()[1]) * brightness)
    return values


def twice_mirrored(model: CameraModel, light: Float64, centres: Float64, radii: Float64) -> Float64:
    """Return the pixel at which the first sphere shows the light as the second mirrors it."""
    seen = centres[1]
    for _ in range(30):
        point = mirror_points(model.centre_mm, seen, centres[0], radii[0])
        seen = mirror_points(point, light, centres[1], radii[1])
    return np.asarray(model.project(point), np.float64)


def peak(image: Float32, place: Float64) -> float:
    x, y = np.rint(place).astype(int)
    return float(np.nanmax(image[y - 2 : y + 3, x - 2 : x + 3]))


def add(image: Float32, place: Float64, brightness: float) -> None:
    y, x = np.indices(image.shape)
    square = (x - place[0]) ** 2 + (y - place[1]) ** 2
    image += (brightness * np.exp(-square / (2 * SIGMA_PX**2))).astype(np.float32)


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--kinds", nargs="*", default=list(KINDS), choices=KINDS)
    parser.add_argument("--verbose", action="store_true", help="print all notices")
    options = parser.parse_args()
    model = smaller(camera(), 0.25)
    scores: dict[tuple[int, str, str], Score] = {}
    for seed in range(options.first, options.first + options.seeds):
        for count in (2, 4):
            values, truth = record(scene_of(seed, count, model, sharp=False), seed)
            spots = np.asarray(truth.highlights_px)
            usual = float(
                np.median([[peak(v, p) for v, p in zip(values, k, strict=True)] for k in spots])
            )
            usual_mm: dict[str, Float64] = {}
            for kind in dict.fromkeys(["plain", *options.kinds]):
                images = disturbed(kind, values, truth, seed)
                for state in ("peaks", "saturated"):
                    score = scores.setdefault((count, kind, state), Score())
                    if state == "saturated":
                        images = np.where(images > 0.1 * usual, np.float32(np.nan), images)
                    off = judge(images, truth, score, usual_mm.get(state), options.verbose)
                    if kind == "plain" and off is not None:
                        usual_mm[state] = off
    print("spheres, spots         highlights  mean mm   silent   named   named wrongly  refused")
    for (count, kind, state), s in scores.items():
        mean = float(np.mean(s.errors_mm)) if s.errors_mm else float("nan")
        print(
            f"{count} x R20  {kind:12} {state:10} {mean:8.2f} {s.silent:8d} {s.named:7d} "
            f"{s.false:10d} {len(s.refused):12d}"
        )
    for text in sorted({text for s in scores.values() for text in s.refused}):
        print(f"refused: {text}")


def judge(
    images: Float32, truth: Truth, score: Score, usual_mm: Float64 | None, verbose: bool
) -> Float64 | None:
    """Calibrate with the true masks, add to the score, and return the errors in mm."""
    masks = list(truth.sphere_masks)
    try:
        found = calibrate_spheres(images, masks=masks, camera=truth.camera, radius_mm=20.0)
    except EstimateError as error:
        score.refused.append(str(error))
        return None
    off = np.asarray(found.lights.positions_mm) - np.asarray(truth.lights.positions_mm)
    errors_mm: Float64 = np.linalg.norm(off, axis=1)
    texts = [
        notice.text.split(":")[0]
        for notice in found.warnings
        if notice.code in ("highlights-undecided", "light-doubtful")
    ]
    named = np.array([any(name in text for text in texts) for name in found.lights.ids])
    if verbose:
        print(errors_mm.round(2).tolist(), [str(notice) for notice in found.warnings])
    wrong = errors_mm > WRONG_MM + (0.0 if usual_mm is None else usual_mm)
    wrong &= usual_mm is not None
    score.errors_mm += errors_mm.tolist()
    score.silent += int(np.sum(wrong & ~named))
    score.named += int(named.sum())
    score.false += int(np.sum(named & ~wrong))
    return errors_mm


if __name__ == "__main__":
    main()
