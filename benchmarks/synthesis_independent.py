"""Sheets of exemplars that were not used for development, against the demands on sheets.

The exemplars, 256 x 256 pixels unless "complete" is named: simulated materials with other seeds and
sizes, random reliefs with consecutive seeds, parts of each relief at other places than those of
`sgp bench synthesis`, parts of owl and plant, DiLiGenT's bear, and two meshes, projected. They are
cut from larger details, as `sgp detail synthesize --crop` does. None is left out because of its
figures. A star marks a figure that misses its demand: a mean detail angle
within 7 % of the exemplar's, slopes within 0.10 of their spread, a spectrum at most 1.5 times as
far as the halves of the exemplar are, a repeat score at most 0.15 above the exemplar's, and steps
across cuts of at most 1.15 times those inside patches. Without --data, only simulated exemplars are
used.

    python benchmarks/synthesis_independent.py --data $SGP_DATA
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from harness import command_line

import acquisition
import processing
import simulator
from benchmarks.paper.sources import relief
from processing import NormalMap

SIDE_PX, PATCH_PX = 256, 48
# Around a simulated exemplar, for the filter that separates its detail.
MARGIN_PX = 32
# Corners of parts: the reliefs' are 1024 x 1024, and the bench uses the part at 300, 300.
PARTS = {
    "reliefs/151.jpg": ((20, 700), (740, 30)),
    "reliefs/160.jpg": ((20, 700), (740, 30)),
    "reliefs/188.jpg": ((20, 700), (740, 30)),
    "normals/plant": ((450, 200), (300, 750)),
    "normals/owl": ((150, 205),),
}


def part(normals: NormalMap, row: int, column: int) -> NormalMap:
    """Return a part of the detail component of a map."""
    detail = processing.separate(normals).detail
    window = slice(row, row + SIDE_PX), slice(column, column + SIDE_PX)
    return NormalMap(detail.normals[window].copy(), detail.mask[window].copy())


def simulated(seed: int, reliefs: int) -> Iterator[tuple[str, NormalMap]]:
    wide = SIDE_PX + 2 * MARGIN_PX
    shapes: dict[str, tuple[simulator.shapes.Surface, float]] = {
        "lizard scales": (simulator.shapes.LizardScales(400, scale_mm=7, seed=seed), 0.3),
        "textile": (simulator.shapes.Textile(400, yarn_mm=4, seed=seed), 0.25),
        "leather": (simulator.shapes.CrackedLeather(400, seed=seed), 0.4),
        "wood carving": (simulator.shapes.WoodCarving(80, seed=seed), 0.3),
        "band noise": (simulator.shapes.BandNoise(100, seed=seed), 0.3),
    }
    for name, (shape, pixel_mm) in shapes.items():
        yield name, part(relief(shape, wide, wide * pixel_mm / 2), MARGIN_PX, MARGIN_PX)
    for number in range(seed, seed + reliefs):
        down, right = np.gradient(simulator.reliefs.random_relief(number, wide))
        vectors = np.dstack([-right, down, np.ones_like(right)])
        made = NormalMap.from_vectors(vectors)
        yield f"random relief {number}", part(made, MARGIN_PX, MARGIN_PX)


def captured(data: Path) -> Iterator[tuple[str, NormalMap]]:
    for name, corners in PARTS.items():
        given = processing.read_normals(data / name).normal_map
        for row, column in corners:
            yield f"{Path(name).stem} at {column},{row}", part(given, row, column)
    bear = processing.read_normals(data / "normals" / "diligent" / "bear")
    yield "bear, complete", processing.separate(bear.normal_map).detail
    for name in ("skull", "stanford-bunny"):
        mesh = processing.read_geometry(data / "meshes" / f"{name}.obj")
        drawn = processing.project(mesh, size=(420, 420)).normal_map
        yield f"{name}, complete", processing.separate(drawn).detail


def marked(value: float, missed: bool) -> str:
    return f"{value:.3f}{'*' if missed else ' '}"


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--data", type=Path, help="folder with normals/, reliefs/ and meshes/")
    parser.add_argument("--seed", type=int, default=31, help="seed of the simulated exemplars")
    parser.add_argument("--reliefs", type=int, default=8, help="number of random reliefs")
    parser.add_argument("--side", type=int, default=2048, help="side of the sheets, pixels")
    options = parser.parse_args()
    print(
        f"{'exemplar':24} {'angle, deg':>10} {'change':>7} {'slopes':>7} {'spectrum':>8}  halves "
        "repeats  exemplar  steps   CPU s"
    )
    exemplars = list(simulated(options.seed, options.reliefs))
    if options.data is not None:
        exemplars += captured(options.data)
    for name, exemplar in exemplars:
        begun = time.process_time()
        try:
            made = processing.synthesize(exemplar, (options.side, options.side), patch=PATCH_PX)
        except acquisition.DataError as error:
            print(f"{name:24} {error}", flush=True)
            continue
        spent = time.process_time() - begun
        found = processing.synthesis.texture_figures(made.detail, exemplar, patch=PATCH_PX)
        change = found.detail_angle_deg / found.exemplar_angle_deg - 1
        halves, own = found.exemplar_spectrum_distance, found.exemplar_repeat_score
        print(
            f"{name:24} {found.exemplar_angle_deg:10.2f} {marked(change, abs(change) > 0.07):>7} "
            f"{marked(found.slope_distance, found.slope_distance > 0.1):>7} "
            f"{marked(found.spectrum_distance, found.spectrum_distance > 1.5 * halves):>8} "
            f"{halves:7.3f} {marked(found.repeat_score, found.repeat_score > own + 0.15):>7} "
            f"{own:9.3f} {marked(made.steps.ratio, made.steps.ratio > 1.15):>7} {spent:6.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
