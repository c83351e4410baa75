"""False alarms, detection and coverage of changes between two recordings of an object.

Simulated objects are recorded with 36 lights, taken away and put back in between: shifted by up to
8 pixels along each axis, turned by up to 6 degrees and tilted by up to 0.3. Noise differs, and each
recording is processed with lights whose stated positions and intensities deviate by 2 % from the
true ones. Recordings of an object that has not changed are compared in pairs; and with recordings
in which scratches and losses were planted. A pixel is 0.05 mm.

    python benchmarks/changes.py --seed 46 --out docs/measured/changes.csv
"""

from __future__ import annotations

import pickle
from argparse import Namespace
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import chain, combinations, pairwise
from pathlib import Path

import cv2
import numpy as np
from changed_objects import (
    OBJECTS,
    PIXEL_MM,
    SIZE,
    Placed,
    Planted,
    altered,
    moved,
    object_named,
    planted,
    recorded,
)
from harness import Table, command_line

from processing.changes import Changes, find_changes
from processing.registration import Field, register_fields
from rig.arrays import Bool

_KINDS = [("scratch", w, d) for w in (0.4, 1.0, 2.0, 4.0) for d in (0.5, 1.0, 2.0, 5.0)]
_KINDS += [("scratch", 2.0, 2.0), ("loss", 7.14, 2.0), ("loss", 7.14, 5.0), ("loss", 7.14, 5.0)]
_UM_PER_PX = 1000 * PIXEL_MM


@dataclass(frozen=True)
class Shot:
    """A field of a recording, with the truth."""

    field: Field
    blur_px: float
    placed: Placed
    planted: tuple[Planted, ...]


def shot(name: str, seed: int, number: int, *, changed: bool, keep: Path | None) -> Shot:
    """Record an object; or load the recording, if it is kept."""
    file = None if keep is None else keep / f"{name}-{seed}-{number}-{changed}.pickle"
    if file is not None and file.exists():
        return pickle.loads(file.read_bytes())
    surface, paint = object_named(name, seed)
    rng = np.random.default_rng([seed, number, changed])
    placed = moved(surface, rng) if number or changed else surface
    plants = planted(_KINDS, rng) if changed else []
    placed = altered(placed, plants)
    made = recorded(placed, paint, 100 * seed + 2 * number + changed)
    field = Field(
        made.normals,
        made.gray_albedo,
        made.maps["normal_sigma_deg"][:],
        made.maps["normal_sigma_common_deg"][:],
    )
    found = Shot(field, 0.7 if made.blur is None else made.blur.sigma_px, placed, tuple(plants))
    if file is not None:
        file.write_bytes(pickle.dumps(found))
    return found


def compared(before: Shot, after: Shot) -> Changes:
    """Return the changes between two recordings."""
    registration = register_fields(before.field, after.field, model="homography")
    there = registration.resampled(after.field)
    blur_px = max(before.blur_px, after.blur_px)
    return find_changes(before.field, there, registration.common, blur_px=blur_px)


def footprint(before: Shot, one: Planted) -> Bool:
    """Return the pixels of a planted change in the image before, with a margin of 3 pixels."""
    x, y = before.placed.place_of(one.change.x_mm, one.change.y_mm)
    ends = [(x, y)]
    if one.change.length_mm:
        half, turn = one.change.length_mm / 2, np.radians(one.change.angle_deg)
        ends = [
            before.placed.place_of(
                one.change.x_mm + side * half * np.cos(turn),
                one.change.y_mm + side * half * np.sin(turn),
            )
            for side in (-1, 1)
        ]
    middle = (SIZE - 1) / 2
    places = [(round(middle + u / PIXEL_MM), round(middle - v / PIXEL_MM)) for u, v in ends]
    drawn = np.zeros((SIZE, SIZE), np.uint8)
    width = round(one.width_px) + 6
    if len(places) == 1:
        cv2.circle(drawn, places[0], width // 2, 1, -1)
    for first, last in pairwise(places):
        cv2.line(drawn, first, last, 1, width)
    return drawn > 0


@dataclass(frozen=True)
class Outcome:
    """What was found on an object: changes of pairs without one, planted ones, and others."""

    alarms: list[int]
    seen: list[tuple[tuple[str, float, float], tuple[float, ...]]]
    others: int


def outcome(name: str, options: Namespace) -> Outcome:
    """Compare the recordings of an object."""
    still, changed = (
        [
            shot(name, options.seed, number, changed=is_changed, keep=options.keep)
            for number in range(count)
        ]
        for count, is_changed in ((options.unchanged, False), (options.changed, True))
    )
    alarms = [len(compared(a, b).changes) for a, b in combinations(still, 2)]
    print(name, alarms, flush=True)
    seen, others = [], 0
    for number, after in enumerate(changed):
        for before in still[number::3]:
            found = compared(before, after)
            claimed = np.zeros((SIZE, SIZE), bool)
            for one in after.planted:
                where = footprint(before, one)
                claimed |= cv2.dilate(where.astype(np.uint8), np.ones((9, 9))) > 0
                if found.difference.known[where].all():
                    key = one.kind, one.width_px, one.depth_um
                    seen.append((key, _judged(found, where, one)))
            others += sum(not claimed[c.row, c.column] for c in found.changes)
    return Outcome(alarms, seen, others)


def main() -> None:
    """Print one row for each kind of change, and for pairs without one."""
    parser = command_line(__doc__)
    parser.add_argument("--seed", type=int, default=46, help="seed of objects, places and noise")
    parser.add_argument("--unchanged", type=int, default=7, help="recordings without a change")
    parser.add_argument("--changed", type=int, default=3, help="recordings with changes")
    parser.add_argument("--objects", nargs="+", default=list(OBJECTS))
    parser.add_argument("--keep", type=Path, help="folder that keeps the recordings")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--out", type=Path, help="table (.csv)")
    options = parser.parse_args()
    with ProcessPoolExecutor(options.processes) as pool:
        outcomes = list(pool.map(partial(outcome, options=options), options.objects))
    seen = defaultdict(list)
    for key, values in chain(*(one.seen for one in outcomes)):
        seen[key].append(values)
    alarms = {name: one.alarms for name, one in zip(options.objects, outcomes, strict=True)}
    others = sum(one.others for one in outcomes)
    table = Table(options.out)
    blank = {"false alarms": "", "found": "", "depth within k=2": "", "width within k=2": ""}
    blank |= {"depth um": "", "width px": "", "mean um": "", "mean sigma um": ""}
    for name, counts in (*alarms.items(), ("all", [*chain(*alarms.values())])):
        row = {"what": f"unchanged, {name}", "maps": str(len(counts))} | blank
        table.add(row | {"false alarms": f"{np.mean(np.array(counts) > 0):.3f}"})
    row = {"what": "changed, elsewhere", "maps": str(len(seen[_KINDS[-1]]) // 2)} | blank
    table.add(row | {"false alarms": str(others)})
    for (kind, width, depth), rows in sorted(seen.items()):
        values = np.array(rows)
        hit = values[values[:, 0] > 0]
        table.add(
            {"what": kind, "maps": str(len(rows))}
            | blank
            | {
                "width px": f"{width:g}",
                "depth um": f"{depth:g}",
                "found": f"{len(hit) / len(rows):.2f}",
                "depth within k=2": f"{hit[:, 1].mean():.2f}" if len(hit) else "",
                "width within k=2": f"{hit[:, 2].mean():.2f}" if len(hit) else "",
                "mean um": f"{hit[:, 3].mean():.2f}" if len(hit) else "",
                "mean sigma um": f"{hit[:, 4].mean():.2f}" if len(hit) else "",
            }
        )


def _judged(found: Changes, where: Bool, one: Planted) -> tuple[float, ...]:
    """Return whether a change was found, depth and width within k = 2, depth and its sigma."""
    here = [c for c in found.changes if c.kind == "surface" and where[c.row, c.column]]
    if not here:
        return float((found.significant & where).any()), 0, 0, np.nan, np.nan
    best = max(here, key=lambda c: abs(c.z))
    depth, sigma = -_UM_PER_PX * best.height_px, _UM_PER_PX * best.height_sigma_px
    within = abs(depth - one.depth_um) <= 2 * sigma
    wide = abs(best.width_px - one.width_px) <= 2 * best.width_sigma_px
    return 1, float(within), float(wide), depth, sigma


if __name__ == "__main__":
    main()
