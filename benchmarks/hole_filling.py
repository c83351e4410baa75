"""Holes in measured normal maps: how well `fill_holes` continues what is around them.

Round holes are cut out at random places of owl and plant and are filled one by one. "angle" is the
mean detail angle inside over that of the complete map within 30 pixels around; "true" is the same
of the map before the hole was cut out. "rim" is the mean step across the rim over that inside, and
its "true" value is that at the same pixels of the given map. The last columns are the CPU time per
hole, and the largest one. A second line per map has the step at the rim over that inside, and the
angle, of discs of the same size in the given map, at more places: how much the map itself varies.

    python benchmarks/hole_filling.py --data $SGP_DATA
"""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
from harness import command_line

import processing
from processing.detail.seam import seam_steps
from rig.arrays import Bool

# Around a hole: a map this much larger is filled, and detail this near is compared.
MARGIN_PX, NEAR_PX = 150, 30


def holes(mask: Bool, side: int, count: int, seed: int) -> list[Bool]:
    """Return round holes at random places, each with at least half of its pixels in the mask."""
    random, found = np.random.default_rng(seed), list[Bool]()
    y, x = np.indices(mask.shape)
    while len(found) < count:
        row, column = random.integers(0, mask.shape[0]), random.integers(0, mask.shape[1])
        disc = np.hypot(y - row, x - column) < side / 2
        if mask[row, column] and np.count_nonzero(disc & mask) > disc.sum() / 2:
            found.append(disc & mask)
    return found


def mean_angle_deg(detail: processing.NormalMap, part: Bool) -> float:
    known = detail.normals[part]
    angles = np.arctan2(np.hypot(known[:, 0], known[:, 1]), known[:, 2])
    return float(np.degrees(angles.mean()))


def around(
    given: processing.NormalMap, detail: processing.NormalMap, hole: Bool
) -> tuple[processing.NormalMap, processing.NormalMap, Bool]:
    """Return the surroundings of a hole: the map, its detail, and the hole."""
    rows, columns = np.nonzero(hole)
    box = (
        slice(max(rows.min() - MARGIN_PX, 0), rows.max() + MARGIN_PX),
        slice(max(columns.min() - MARGIN_PX, 0), columns.max() + MARGIN_PX),
    )
    part, true = (processing.NormalMap(of.normals[box], of.mask[box]) for of in (given, detail))
    return part, true, hole[box]


def steepness_and_rim(
    normals: processing.NormalMap,
    detail: processing.NormalMap,
    true: processing.NormalMap,
    inside: Bool,
) -> tuple[float, float]:
    """Return the mean angle inside over that of the given detail around, and the step at the rim.

    The step is relative to that inside.
    """
    away = cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, 3)
    near = (away <= NEAR_PX) & true.mask & ~inside
    angle = mean_angle_deg(detail, inside) / mean_angle_deg(true, near)
    return angle, seam_steps(normals, inside).ratio


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder with normals/")
    parser.add_argument("--side", type=int, default=60, help="diameter of the holes, pixels")
    parser.add_argument("--count", type=int, default=20, help="number of holes per map")
    parser.add_argument("--places", type=int, default=200, help="number of undamaged places")
    parser.add_argument("--seed", type=int, default=2056, help="seed of their places")
    parser.add_argument("--patch", type=int, default=12, help="side of the patches, pixels")
    options = parser.parse_args()
    print("map    angle  true (worst)        rim  true (worst)   CPU s  most")
    for name in ("owl", "plant"):
        given = processing.read_normals(options.data / "normals" / name).normal_map
        detail = processing.separate(given).detail
        figures = []
        for hole in holes(given.mask, options.side, options.count, options.seed):
            part, true, inside = around(given, detail, hole)
            begun = time.process_time()
            filled = processing.fill_holes(part, inside, patch=options.patch)
            spent = time.process_time() - begun
            true_angle, true_rim = steepness_and_rim(part, true, true, inside)
            angle, rim = steepness_and_rim(filled.normal_map, filled.detail, true, inside)
            figures.append((angle, true_angle, rim, true_rim, spent))
        angle, true_angle, rim, true_rim, spent_s = np.array(figures).T
        worst = angle[np.argmax(np.abs(angle - 1))]
        print(
            f"{name:6} {angle.mean():5.2f} {true_angle.mean():5.2f} ({worst:.2f}, "
            f"{np.count_nonzero(np.abs(angle - 1) <= 0.15)} of {len(angle)} within 15 %)"
            f" {rim.mean():5.2f} {true_rim.mean():5.2f} ({rim.max():.2f}, "
            f"{np.count_nonzero(rim <= 1.2)} of {len(rim)} up to 1.2)"
            f" {np.median(spent_s):6.2f} {spent_s.max():5.2f}",
            flush=True,
        )
        angle, rim = np.array(
            [
                steepness_and_rim(part, true, true, inside)
                for part, true, inside in (
                    around(given, detail, hole)
                    for hole in holes(given.mask, options.side, options.places, options.seed + 1)
                )
            ]
        ).T
        print(
            f"{name}, undamaged: step at the rim {rim.mean():.2f} (standard deviation "
            f"{rim.std():.2f}, above 1.2 at {np.mean(rim > 1.2):.0%} of {len(rim)} places, at most "
            f"{rim.max():.2f}); angle beyond 15 % at {np.mean(np.abs(angle - 1) > 0.15):.0%}",
            flush=True,
        )


if __name__ == "__main__":
    main()
