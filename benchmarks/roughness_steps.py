"""Coverage of the uncertainty of a step of 50 um, on simulated recordings with three pixel sizes.

For example:

    python benchmarks/roughness_steps.py --seed 900 --count 50 --out steps.csv
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from changed_objects import PIXEL_MM, SIZE, Placed, recorded
from roughness_coverage import error_model, write_table

from processing import integrate
from processing.roughness import Line, measure_step
from rig.arrays import Float64
from simulator.shapes.grounds import Cork
from simulator.shapes.surface import Surface

STEP_MM = 0.05
# Images across the same field, and pixels of the flank from its foot to its top.
SIZES, FLANK_PX = (180, 260, 360), 11
RADIUS_MM = 9.4


@dataclass(frozen=True)
class Plate(Surface):
    """A plate with a step up to the right, whose flank is half a wave of a cosine."""

    flank_mm: float = 1.0

    def evaluate(self, x_mm: Float64, y_mm: Float64) -> tuple[Float64, Float64, Float64]:
        """Return height and gradient at positions."""
        share = np.clip(np.asarray(x_mm) / self.flank_mm + 0.5, 0, 1)
        height = STEP_MM * (1 - np.cos(np.pi * share)) / 2
        slope = STEP_MM * np.pi / 2 * np.sin(np.pi * share) / self.flank_mm
        return height, slope, 0 * slope


class Row(NamedTuple):
    """A step of a recording."""

    pixel_mm: float
    seed: int
    truth_um: float
    value_um: float
    sigma_um: float


def recording(job: tuple[int, int]) -> Row:
    """Return the step of a recording (size of the images, seed)."""
    size, seed = job
    rng = np.random.default_rng(seed)
    pixel = PIXEL_MM * SIZE / size
    surface = Placed(
        RADIUS_MM,
        (Plate(RADIUS_MM, FLANK_PX * pixel),),
        turn_deg=float(rng.uniform(-8, 8)),
        shift_mm=(float(rng.uniform(-1, 1)), float(rng.uniform(-1, 1))),
    )
    made = recorded(surface, Cork(0.5, 0.6, 0.6, seed), seed, size=size, error=0.005, stated=True)
    found = integrate(made.normals, camera=made.source.camera, discontinuity=False)
    errors, resolution = error_model(made, found.pixel_size)
    middle = size / 2 + surface.shift_mm[0] / pixel
    row = size / 2 - surface.shift_mm[1] / pixel
    line = Line(middle - 45, row, middle + 45, row, 7)
    step = measure_step(found.height, line, resolution, errors).quantities["d"]
    return Row(found.pixel_size, seed, 1000 * STEP_MM, step.value, step.sigma)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=900)
    parser.add_argument("--count", type=int, default=50, help="recordings of each pixel size")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    jobs = [
        (size, options.seed + 1000 * k + i)
        for i in range(options.count)
        for k, size in enumerate(SIZES)
    ]
    rows: list[Row] = []
    with ProcessPoolExecutor(options.processes) as pool:
        for done, found in enumerate(pool.map(recording, jobs), 1):
            rows.append(found)
            print(f"{done} of {len(jobs)}: {found}", flush=True)
    table = list(summary(rows))
    for line in (HEAD, *table):
        print(*line, sep="  ")
    if options.out:
        write_table(options.out, HEAD, table)


HEAD = (
    "pixel mm",
    "recordings",
    "within k = 2",
    "error / sigma rms",
    "error / sigma mean",
    "sigma um median",
)


def summary(rows: list[Row]) -> Iterator[tuple[str, ...]]:
    """Yield the columns of `HEAD` for each pixel size."""
    for pixel in sorted({row.pixel_mm for row in rows}):
        these = [row for row in rows if row.pixel_mm == pixel]
        z = np.array([(row.value_um - row.truth_um) / row.sigma_um for row in these])
        yield (
            f"{pixel:.3f}",
            str(len(z)),
            f"{np.mean(np.abs(z) <= 2):.2f}",
            f"{np.sqrt(np.mean(z**2)):.2f}",
            f"{np.mean(z):+.2f}",
            f"{np.median([row.sigma_um for row in these]):.3g}",
        )


if __name__ == "__main__":
    main()
