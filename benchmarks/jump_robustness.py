"""Surfaces with jumps when the constants of the search move by a third.

Each constant of the modules that find and place jumps is multiplied by 4/3 and by 3/4, one at a
time, in a copy of the packages. A row shows the geometric mean over the scenes of a kind of the
error relative to that with the constants as they are; ``--data`` adds objects of DiLiGenT, without
and with 3 degrees of noise. The scenes are those of ``occlusion_scenes.py``, sharp and blurred,
without and with noise.

    python benchmarks/jump_robustness.py --kinds heaps horns --only _LEAST_GAIN
"""

from __future__ import annotations

import ast
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from discontinuity import error_mm, noisy, object_of
from discontinuity_scenes import error_px
from harness import command_line
from occlusion_scenes import KINDS, scene

import processing

MODULES = (
    "jump_evidence",
    "jump_resampling",
    "placement",
    "piece_heights",
    "alternation",
    "jump_kernels",
    "jumps",
)
PACKAGES = ("rig", "acquisition", "calibration", "processing")
ROOT = Path(processing.__file__).parents[1]
# Names, units and samples: to move them means nothing, or does not change the surface.
FIXED = {"_MEDIAN_TO_SIGMA", "_SAMPLES", "_LARGEST_EXPONENT", "_LEAST_SUM"}
FIXED |= {"_SETTLED_PX", "_SETTLED_QUANTILE", "_JUMP_PX", "_JUMP_TRUST", "_PIECE_TRUST"}
FIXED |= {"_SMALLEST_PIECE", "_SMALLEST_SHARE"}


class Number(NamedTuple):
    """A number in a module: its constant, value, line, and columns."""

    name: str
    value: float
    line: int
    begin: int
    end: int


def constants(text: str) -> list[Number]:
    """Return the numbers of the constants of a module."""
    found = []
    for line in ast.parse(text).body:
        if not isinstance(line, ast.Assign | ast.AnnAssign):
            continue
        targets = line.targets if isinstance(line, ast.Assign) else [line.target]
        parts = [part for target in targets for part in ast.walk(target)]
        names = [part.id for part in parts if isinstance(part, ast.Name)]
        numbers = [part for part in ast.walk(line) if isinstance(part, ast.Constant)]
        for k, part in enumerate(each for each in numbers if isinstance(each.value, int | float)):
            name = names[min(k, len(names) - 1)]
            if name.isupper() and name not in FIXED and isinstance(part.value, int | float):
                end = part.end_col_offset or 0
                found.append(Number(name, part.value, part.lineno, part.col_offset, end))
    return found


def moved(text: str, number: Number, factor: float) -> str:
    """Return the text of a module with one number multiplied; integers move by at least one."""
    value = number.value * factor
    if isinstance(number.value, int):
        value = max(round(value), number.value + 1) if factor > 1 else round(value)
    elif 0.5 < number.value < 1:
        # Probabilities and quantiles stay below 1: their distance from 1 moves.
        value = 1 - (1 - number.value) / factor
    lines = text.splitlines(keepends=True)
    line = lines[number.line - 1]
    lines[number.line - 1] = f"{line[: number.begin]}{value!r}{line[number.end :]}"
    return "".join(lines)


def errors(kinds: list[str], seeds: range, data: Path | None) -> dict[str, list[float]]:
    """Return the errors of all scenes of each kind, and of each object."""
    found: dict[str, list[float]] = {}
    for kind in kinds:
        for seed in seeds:
            for blur_px in (0.0, 0.6):
                made = scene(kind, seed, 112, blur_px)
                for noise_deg in (0.0, 3.0):
                    normals = made.noisy(noise_deg, seed)
                    surface = processing.integrate(normals, discontinuity=True)
                    found.setdefault(kind, []).append(error_px(surface, made.height))
    for folder in [] if data is None else sorted(data.iterdir()):
        if (folder / "K.txt").exists():
            normals, camera, depth = object_of(folder)
            for noise_deg in (0.0, 3.0):
                given = noisy(normals, noise_deg, 1000) if noise_deg else normals
                surface = processing.integrate(given, camera=camera, discontinuity=True)
                name = f"{folder.name}{' noisy' if noise_deg else ''}"
                found[name] = [error_mm(surface, depth, normals.mask)]
    return found


def errors_with(module: str, text: str, words: list[str]) -> dict[str, list[float]]:
    """Return the errors with another text of a module, in a copy of the packages."""
    with tempfile.TemporaryDirectory() as folder:
        for package in PACKAGES:
            shutil.copytree(ROOT / package, Path(folder) / package)
        (Path(folder) / f"processing/surface/{module}.py").write_text(text, encoding="utf-8")
        environment = {**os.environ, "PYTHONPATH": folder, "PYTHONSAFEPATH": ""}
        run = subprocess.run(
            [sys.executable, __file__, "--errors", *words],
            env=environment,
            stdout=subprocess.PIPE,
            check=True,
        )
    found: dict[str, list[float]] = json.loads(run.stdout)
    return found


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--first-seed", type=int, default=100, help="first seed of the scenes")
    parser.add_argument("--seeds", type=int, default=2, help="number of seeds")
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=list(KINDS), help="classes")
    parser.add_argument("--data", type=Path, help="folder of the objects of DiLiGenT")
    parser.add_argument("--only", nargs="*", help="names of constants; default: all")
    parser.add_argument("--errors", action="store_true", help="print the errors as JSON, and end")
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    if options.errors:
        print(json.dumps(errors(options.kinds, seeds, options.data)))
        return
    base = errors(options.kinds, seeds, options.data)
    print("errors:", " ".join(f"{name} {np.mean(values):.3f}" for name, values in base.items()))
    words = ["--first-seed", str(seeds.start), "--seeds", str(len(seeds))]
    words += ["--kinds", *options.kinds]
    words += [] if options.data is None else ["--data", str(options.data)]
    for module in MODULES:
        text = (ROOT / f"processing/surface/{module}.py").read_text(encoding="utf-8")
        for number in constants(text):
            if options.only is not None and number.name not in options.only:
                continue
            for factor in (4 / 3, 3 / 4):
                found = errors_with(module, moved(text, number, factor), words)
                ratios = {
                    kind: np.exp(np.log(np.array(found[kind]) / base[kind]).mean()) for kind in base
                }
                worst = max(ratios.values())
                columns = " ".join(f"{kind} {ratio:.2f}" for kind, ratio in ratios.items())
                change = f"{number.name:20} {number.value:8g} x {factor:.2f}"
                print(
                    f"{change} worst {worst:.2f}: {columns}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
