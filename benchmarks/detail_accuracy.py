"""Compute the accuracy figures of docs/detail.md from the maps in the folder SGP_DATA.

The first table has the mean errors in degrees of a transfer onto the five DiLiGenT targets (w=5,
source tiled): shape and detail by the separation's own filter, both by the paper's filter, and both
by the own filter after one refinement. The second table compares the filters near depth jumps on
the same targets: the angle to z of the shape that is left in the detail, by the own filter and by
the paper's, within 5 pixels of a step of more than 5 mm between neighbours; and the mean angle of
the detail farther away, in degrees and as a share of that of the Gaussians. "worst" is the largest
angle near the jumps of a single target, by the own filter. "interior" is the share of order 1 where
outlines and steps of more than 1 mm are more than 5 pixels away. All other figures are means of the
targets' means.
"""

from __future__ import annotations

import os
from pathlib import Path
from statistics import fmean

import cv2
import numpy as np
from harness import command_line

from acquisition import angle_deg
from processing import NormalMap, ShapeFilter, read_normals, transfer
from processing.detail import FilterKind
from rig.arrays import Bool, Float64

FILTERS: tuple[tuple[FilterKind, int], ...] = (
    ("gaussian", 1), ("gaussian", 8), ("guided", 1), ("bilateral", 1),
)  # fmt: skip
TARGETS = ("bear", "buddha", "cat", "cow", "goblet")
NEAR_PX, STEP_MM, LOW_STEP_MM = 5, 5.0, 1.0
PAPER = ShapeFilter("gaussian", 1)


def near_jumps(folder: Path, mask: Bool, step_mm: float = STEP_MM) -> Bool:
    """Return the pixels of a mask that are near a step of the true depth inside the mask."""
    with np.load(folder / "depth_gt.npz") as arrays:
        depth = arrays[arrays.files[0]].astype(np.float64)
    jumps = np.zeros(mask.shape, np.uint8)
    for axis in (0, 1):
        a, b = ([slice(None)] * 2 for _ in range(2))
        a[axis], b[axis] = slice(None, -1), slice(1, None)
        first, second = tuple(a), tuple(b)
        step = np.abs(depth[second] - depth[first]) > step_mm
        step &= mask[first] & mask[second]
        jumps[first] |= step
        jumps[second] |= step
    away = cv2.distanceTransform(1 - jumps, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(mask & (away <= NEAR_PX))


def interior(folder: Path, mask: Bool) -> Bool:
    """Return the pixels of a mask that are near neither its outline nor a low step."""
    inside = np.pad(mask, 1).astype(np.uint8)
    to_outline = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    low = near_jumps(folder, mask, LOW_STEP_MM)
    return np.asarray(mask & ~low & (to_outline > NEAR_PX))


def to_z(normal_map: NormalMap, where: Bool) -> Float64:
    return angle_deg(normal_map.normals[where], (0.0, 0.0, 1.0))


def main() -> None:
    command_line(__doc__).parse_args()
    if "SGP_DATA" not in os.environ:
        print("SGP_DATA is not set: nothing to measure")
        return
    folder = Path(os.environ["SGP_DATA"]) / "normals"
    targets = {name: read_normals(folder / "diligent" / name).normal_map for name in TARGETS}
    print(f"{'source':10}{'own filter':>14}{'paper filter':>16}{'refined once':>16}")
    for name in ("owl", "plant"):
        source = read_normals(folder / name).normal_map
        once = [transfer(source, target) for target in targets.values()]
        refined = [transfer(source, target, refine=1) for target in targets.values()]
        print(f"{name:10}", end="")
        for done in (
            [one.fidelity for one in once],
            [one.fidelity_paper for one in once],
            [one.fidelity for one in refined],
        ):
            shape = fmean(one.shape_mae_deg for one in done)
            detail = fmean(one.detail_mae_deg for one in done)
            print(f"{shape:8.2f} /{detail:5.2f}", end="")
        print()
    near = {name: near_jumps(folder / "diligent" / name, targets[name].mask) for name in TARGETS}
    inner = {
        name: interior(folder / "diligent" / name, target.mask) for name, target in targets.items()
    }
    print(
        f"\n{'filter':14}{'own filter':>12}{'worst':>7}{'paper filter':>14}{'detail away':>13}"
        f"{'interior':>10}"
    )
    gaussians: list[float] = []
    first_within = 0.0
    for kind, order in FILTERS:
        by = ShapeFilter(kind, order)
        own, paper, away, within = [], [], [], []
        for name, target in targets.items():
            detail = by.split(target)[1]
            own.append(to_z(by.shape(detail), near[name]))
            paper.append(to_z(PAPER.shape(detail), near[name]))
            away.append(to_z(detail, target.mask & ~near[name]))
            within.append(to_z(detail, inner[name]))
        figures = [fmean(float(one.mean()) for one in each) for each in (own, paper, away, within)]
        first_within = first_within or figures[3]
        worst = max(float(one.mean()) for one in own)
        if kind == "gaussian":
            gaussians.append(figures[2])
        shares = ", ".join(f"{figures[2] / one:.0%}" for one in gaussians)
        print(
            f"{f'{kind}, {order}':14}{figures[0]:12.2f}{worst:7.2f}{figures[1]:14.2f}"
            f"{figures[2]:13.2f}{figures[3] / first_within:10.0%}   {shares}"
        )


if __name__ == "__main__":
    main()
