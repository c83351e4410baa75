"""Coverage of the uncertainties of areal parameters, on simulated recordings.

For example:

    python benchmarks/roughness_coverage.py --seed 700 --count 200 --out coverage.csv
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from changed_objects import DISTANCE_MM, PIXEL_MM, SIZE, object_named, recorded

from processing import Reconstruction, integrate
from processing.roughness import (
    AREAL,
    ErrorModel,
    NormalErrors,
    Resolution,
    Scales,
    areal_parameters,
    measure_area,
    scale_limited,
)
from rig.arrays import Float64
from simulator.shapes.surface import Surface

SURFACES = ("coin", "leather", "textile", "woodcarving", "print", "plaster")
# The area, pixels from the middle of the image, and samples per pixel of the truth.
_HALF = 110
_FINE = 4
# Blur by the aberrations of lenses in focus; the program does not know it.
_BLUR_PX = (0.4, 1.0)


class Row(NamedTuple):
    """A parameter of a recording."""

    surface: str
    seed: int
    parameter: str
    truth: float
    measured: float
    value: float
    sigma: float
    assured: bool


def true_heights(surface: Surface) -> Float64:
    """Return the heights that the pixels of the area see, `_FINE` samples per pixel and side."""
    margin = 60
    count = 2 * (_HALF + margin) * _FINE
    at = ((np.arange(count) + 0.5) / _FINE - _HALF - margin) * PIXEL_MM
    x, y = np.meshgrid(at, -at)
    height = np.zeros(x.shape)
    for _ in range(4):
        nearer = (DISTANCE_MM - height) / DISTANCE_MM
        height = surface.evaluate(x * nearer, y * nearer)[0]
    return height


def error_model(made: Reconstruction, pixel_mm: float) -> tuple[ErrorModel, Resolution]:
    """Return the errors of a recording, as `sgp roughness` reads them from a result."""
    if made.blur is None:
        raise SystemExit("the noise of the recording is not known")
    sigma = np.asarray(made.maps["normal_sigma_deg"][:])
    common = float(np.nanmedian(made.maps["normal_sigma_common_deg"][:]))
    blur = made.blur.sigma_px if made.blur.shown else None
    errors = ErrorModel(NormalErrors(made.normals.normals, sigma, common))
    return errors, Resolution.seen(pixel_mm, blur)


def recording(job: tuple[str, int], lights_error: float) -> list[Row]:
    """Return the parameters of a recording of a surface (name, seed)."""
    name, seed = job
    surface, paint = object_named(name, seed)
    rng = np.random.default_rng(seed)
    surface = replace(surface, turn_deg=float(rng.uniform(0, 360)))
    blur_px = float(rng.uniform(*_BLUR_PX))
    made = recorded(surface, paint, seed, error=lights_error, stated=True, blur_px=blur_px)
    normals = made.normals
    found = integrate(normals, camera=made.source.camera, discontinuity=False)
    errors, resolution = error_model(made, found.pixel_size)
    area = np.zeros(normals.size, bool)
    middle = SIZE // 2
    area[middle - _HALF : middle + _HALF, middle - _HALF : middle + _HALF] = True
    heights = found.height
    measured = measure_area(heights, area, resolution, Scales(), errors)
    fine = Resolution(PIXEL_MM / _FINE)
    whole = true_heights(surface)
    inside = np.zeros(whole.shape, bool)
    inside[60 * _FINE : -60 * _FINE, 60 * _FINE : -60 * _FINE] = True
    truth = areal_parameters(scale_limited(whole, inside, measured.scales, fine), fine.pixel_mm)
    return [
        Row(name, seed, key, truth[key], one.measured, one.value, one.sigma, not one.doubts)
        for key, one in measured.quantities.items()
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=700)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--light-error", type=float, default=0.005)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--rows", type=Path, help="table of all parameters; read if it exists")
    parser.add_argument("--out", type=Path, help="table of the coverage")
    options = parser.parse_args()
    if options.rows and options.rows.exists():
        rows = read_rows(options.rows)
    else:
        jobs = [(SURFACES[i % len(SURFACES)], options.seed + i) for i in range(options.count)]
        rows = []
        with ProcessPoolExecutor(options.processes) as pool:
            measure = partial(recording, lights_error=options.light_error)
            for done, found in enumerate(pool.map(measure, jobs), 1):
                rows += found
                print(f"{done} of {len(jobs)}", flush=True)
        if options.rows:
            write_table(options.rows, Row._fields, rows)
    table = list(summary(rows))
    for line in (HEAD, *table):
        print(*line, sep="  ")
    if options.out:
        write_table(options.out, HEAD, table)


def write_table(path: Path, head: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    with path.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(head)
        table.writerows(rows)


def read_rows(path: Path) -> list[Row]:
    with path.open(newline="") as file:
        return [
            Row(
                one["surface"],
                int(one["seed"]),
                one["parameter"],
                *(float(one[key]) for key in ("truth", "measured", "value", "sigma")),
                one["assured"] == "True",
            )
            for one in csv.DictReader(file)
        ]


def error(row: Row) -> float:
    """Return value minus truth; of a direction, the smallest angle."""
    off = row.value - row.truth
    return (off + 90) % 180 - 90 if AREAL[row.parameter].kind == "angle" else off


HEAD = (
    "parameter",
    "recordings",
    "assured",
    "within k = 2",
    "error / sigma rms",
    "error / sigma mean",
    "error / truth median",
)


def summary(rows: list[Row]) -> Iterator[tuple[str, ...]]:
    """Yield the columns of `HEAD` for each parameter."""
    for name in AREAL:
        these = [row for row in rows if row.parameter == name and math.isfinite(row.truth)]
        kept = [row for row in these if row.assured and row.sigma > 0]
        if not kept:
            yield (name, str(len(these)), "0", "", "", "", "")
            continue
        z = np.array([error(row) / row.sigma for row in kept])
        share = np.median([abs(error(row) / row.truth) for row in kept])
        yield (
            name,
            str(len(these)),
            str(len(kept)),
            f"{np.mean(np.abs(z) <= 2):.3f}",
            f"{np.sqrt(np.mean(z**2)):.2f}",
            f"{np.mean(z):+.2f}",
            f"{share:.2%}",
        )


if __name__ == "__main__":
    main()
