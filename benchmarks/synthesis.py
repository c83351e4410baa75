"""Synthesised detail: how well sheets of 2048 x 2048 pixels keep the character of an exemplar.

Exemplars are materials of the simulator and, with ``--data``, the reliefs and the normal maps of
owl and plant. An exemplar is 256 x 256 pixels, or complete where named. "slopes" are the distance
of the distributions of slopes relative to their spread; spectrum and repeat score are followed by
those of the exemplar's halves and of the exemplar. "steps" is the mean step across cuts over that
inside patches. The last rows are the cost of sheets of 1, 5 and 20 million pixels. The first row
contains the time for compiling.

    python benchmarks/synthesis.py --data $SGP_DATA
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from harness import command_line, measured

import processing
import simulator

SIDE, MARGIN = 256, 22
PIXEL_MM = 0.3
MATERIALS: dict[str, Callable[..., Any]] = {
    "lizard scales": partial(simulator.LizardScales, radius_mm=400, scale_mm=10),
    "textile": partial(simulator.Textile, radius_mm=400, yarn_mm=6),
    "leather": partial(simulator.CrackedLeather, radius_mm=400),
}


def crop(part: processing.NormalMap, top: int, left: int) -> processing.NormalMap:
    window = slice(top, top + SIDE), slice(left, left + SIDE)
    return processing.NormalMap(part.normals[window].copy(), part.mask[window].copy())


def material(name: str, seed: int) -> processing.NormalMap:
    """Return the detail of a simulated material, seen from above."""
    size = SIDE + 2 * MARGIN
    y, x = (np.mgrid[:size, :size] - size / 2) * PIXEL_MM
    _, slope_x, slope_y = MATERIALS[name](seed=seed).evaluate(x, -y)
    normals = processing.NormalMap.from_vectors(
        np.dstack([-slope_x, -slope_y, np.ones_like(slope_x)])
    )
    return crop(processing.separate(normals).detail, MARGIN, MARGIN)


def captured(data: Path) -> Iterator[tuple[str, processing.NormalMap]]:
    """Yield the details of the reliefs, crops first, and of the normal maps in a folder."""
    for path in sorted((data / "reliefs").glob("*.jpg")):
        detail = processing.separate(processing.read_normals(path).normal_map).detail
        yield f"relief {path.stem}", crop(detail, 300, 300)
        yield f"relief {path.stem}, complete", detail
    for name in ("owl", "plant"):
        read = processing.read_normals(data / "normals" / name)
        yield f"{name}, complete", processing.separate(read.normal_map).detail


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--data", type=Path, help="folder with reliefs/ and normals/")
    parser.add_argument("--seed", type=int, default=7, help="seed of the materials")
    parser.add_argument("--side", type=int, default=2048, help="side of the sheets, pixels")
    parser.add_argument("--patch", type=int, default=48, help="side of the patches, pixels")
    options = parser.parse_args()
    exemplars = [(name, material(name, options.seed)) for name in MATERIALS]
    exemplars += [] if options.data is None else captured(options.data)
    print(
        f"{'exemplar':22} angle, deg   sheet  slopes  spectrum, halves  repeat, exemplar  steps"
        "  CPU s"
    )
    for name, exemplar in exemplars:
        side = options.side
        cost, made = measured(
            partial(processing.synthesize, exemplar, (side, side), patch=options.patch)
        )
        found = processing.texture_figures(made.detail, exemplar, patch=options.patch)
        change = found.detail_angle_deg / found.exemplar_angle_deg - 1
        print(
            f"{name:22} {found.exemplar_angle_deg:10.2f} {change:+7.1%} {found.slope_distance:7.3f}"
            f" {found.spectrum_distance:9.3f} {found.exemplar_spectrum_distance:7.3f}"
            f" {found.repeat_score:8.3f} {found.exemplar_repeat_score:9.3f}"
            f" {made.steps.ratio:6.2f} {cost.cpu_s:6.2f}",
            flush=True,
        )
    print("\n   pixels   CPU s  growth MB  sheet MB")
    for side in (1000, 2236, 4472):
        cost, _ = measured(
            partial(processing.synthesize, exemplars[0][1], (side, side), patch=options.patch)
        )
        print(f"{side * side:9,} {cost.cpu_s:7.2f} {cost.peak_mb:10.0f} {side * side * 12e-6:9.0f}")


if __name__ == "__main__":
    main()
