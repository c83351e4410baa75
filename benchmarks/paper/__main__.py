"""Recompute the paper's tables next to the published figures, from maps in SGP_DATA or simulated.

transfer: properties and transfers of details, next to two mesh methods: displacement (DSPL) and
Laplacian editing (LAPL). --quick uses at most 50 thousand points and one run per measurement:
about two minutes.

synthesis: sheets next to their exemplars, and to repeated and mirrored exemplars, with time and
memory for as many pixels as the paper's target has. --quick makes sheets of 1024 x 1024 instead of
2048 x 2048 pixels without complete maps as exemplars: about two minutes instead of five.

superres: super-resolution of normals and of details next to bicubic interpolation: errors of
normals and heights by class of surface, and how well the predicted deviations agree with the
errors. --quick uses the middle 256 x 256 pixels of the maps, and only scale 4.

The output folder has tables.md, tables.json, pictures, height profiles as .csv, and bench.json
with the parameters and the hashes of all inputs.

    python -m benchmarks.paper --out tables --quick
    python -m benchmarks.paper --table superres --models trained --out tables
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

# Before numpy is loaded: idle threads of BLAS would spin and count as CPU time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import acquisition
from benchmarks.harness import command_line
from benchmarks.paper.comparison import Comparison
from benchmarks.paper.run import run_all
from benchmarks.paper.sheets import run_sheets
from benchmarks.paper.superres import run_superres
from benchmarks.paper.tables import markdown
from sgp.cli.console import note
from sgp.cli.exit import FAULT, UsageError, error_text, exit_code
from sgp.pictures import write_overview
from sgp.results import Result, check_output, claim_folder, dumps, write_record
from sgp.stages.write_profile import write_profile_data

RECORD = "bench.json"
# For each group of tables: the function that computes them, and its options with their defaults.
TABLES: Mapping[str, tuple[Callable[..., Comparison], Mapping[str, Any]]] = {
    "transfer": (run_all, {"runs": None}),
    "synthesis": (run_sheets, {"seed": 7}),
    "superres": (run_superres, {"seed": 7, "models": None}),
}


def main(words: Sequence[str] | None = None) -> int:
    """Compute a group of tables and write them; return the exit code."""
    parser = command_line(__doc__)
    parser.add_argument("--table", choices=tuple(TABLES), default="transfer", help="the tables")
    parser.add_argument("--out", type=Path, required=True, help="output folder")
    parser.add_argument("--quick", action="store_true", help="compute less, as above")
    parser.add_argument(
        "--runs",
        type=_at_least(1),
        metavar="N",
        help="transfer: runs per measurement, which are averaged; 10 as in the paper if not given, "
        "1 with --quick",
    )
    parser.add_argument(
        "--seed",
        type=_at_least(0),
        metavar="N",
        help="synthesis and superres: seed of the simulated materials; 7 if not given",
    )
    parser.add_argument(
        "--models",
        type=Path,
        help="superres: folder with networks (.onnx) and their descriptions, of both domains and "
        "several seeds of the training, which should be trained alike",
    )
    parser.add_argument("--force", action="store_true", help="write into a folder with files")
    options = parser.parse_args(words)
    compute, defaults = TABLES[options.table]
    names = ("runs", "seed", "models")
    given = {name: getattr(options, name) for name in names if getattr(options, name) is not None}
    for name in given.keys() - defaults:
        parser.error(f"--{name} is not an option of --table {options.table}")
    parameters = {"quick": options.quick, **defaults, **given}
    try:
        if options.models is not None and not options.models.is_dir():
            raise UsageError(f"{options.models}: no such folder")
        check_output(options.out, parameters.values(), force=options.force)
        result = _written(compute(**parameters, advance=_Steps()), options.out)
        command = f"python -m benchmarks.paper --table {options.table}"
        write_record(options.out / RECORD, command, parameters, result)
    except Exception as error:
        if exit_code(error) == FAULT:
            raise
        print(f"error: {error_text(error)}", file=sys.stderr)
        return exit_code(error)
    for notice in result.warnings:
        note(f"{notice.label}: {notice}")
    print(*result.summary, sep="\n")
    return 0


def _at_least(least: int) -> Callable[[str], int]:
    """Return a converter of an option's text to a whole number that refuses smaller ones."""

    def number(text: str) -> int:
        if int(text) < least:
            raise ValueError(text)
        return int(text)

    return number


def _written(comparison: Comparison, out: Path) -> Result:
    """Write tables, pictures and profiles into a folder."""
    claim_folder(out, RECORD)
    result = Result(warnings=list(comparison.left_out), inputs=comparison.files)
    result.metrics = {"tables": len(comparison.tables)}
    result.outputs = {"tables": out / "tables.md", "tables_json": out / "tables.json"}
    for name, picture in comparison.pictures.items():
        result.outputs[name] = out / f"{name}.png"
        write_overview(result.outputs[name], *picture)
    for name, profile in comparison.profiles.items():
        result.outputs[f"{name}_data"] = out / f"{name}.csv"
        write_profile_data(result.outputs[f"{name}_data"], profile)
    left_out = [f"Note: {line}." for line in comparison.left_out]
    text = "\n\n".join([comparison.preface, *left_out, *map(markdown, comparison.tables)])
    acquisition.write_durably(result.outputs["tables"], f"{text}\n".encode())
    tables = {table.key: asdict(table) for table in comparison.tables}
    acquisition.write_durably(result.outputs["tables_json"], f"{dumps(tables)}\n".encode())
    result.summary = [f"{len(comparison.tables)} tables in {result.outputs['tables']}"]
    return result


class _Steps:
    """Print each step before it begins, with the time that is left for its table."""

    def __init__(self) -> None:
        self._began_s = 0.0

    def __call__(self, step: str, done: int, total: int, /) -> None:
        now_s = time.monotonic()
        if done == 0:
            self._began_s = now_s
            note(step)
            return
        left_s = (now_s - self._began_s) * (total - done) / done
        note(f"{step}; about {left_s:.0f} s left for this table")


if __name__ == "__main__":
    raise SystemExit(main())
