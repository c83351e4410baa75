"""Recompute the paper's tables next to the published figures, from maps in SGP_DATA or simulated.

properties: shape, separability, idempotence, chains of transfers, exchange of two details.

transfer: transfers of details, next to displacement (DSPL) and Laplacian editing (LAPL).

synthesis: sheets next to their exemplars, and to repeated and mirrored exemplars.

superres: super-resolution next to bicubic interpolation, PU-Net, and RDN on normals and on details.

surface: surfaces from normals, next to Xie et al. (2014), the method of the paper.

costs: time and memory of every system on the same target, over those of this program.

Each group has a folder in --out with tables.json, pictures, height profiles as .csv, and bench.json
with parameters, hashes of all inputs, and what the group took. A group that is done is not repeated
by the same command. paper.md is a page with the main tables of all groups in the folder, paper.csv
has the figures of all tables. In docs/measured are those of --quick.
--quick stops at 160 thousand points and one run, and uses smaller sheets and parts of maps.

    python -m benchmarks.paper --out tables --quick
    python -m benchmarks.paper --out tables --table superres --models trained
"""

from __future__ import annotations

import csv
import io
import json
import os
import resource
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

# Before numpy is loaded: idle threads of BLAS would spin and count as CPU time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import acquisition
from benchmarks.harness import command_line, peak_begins, resident_bytes
from benchmarks.paper.comparison import Comparison
from benchmarks.paper.costs import run_costs
from benchmarks.paper.run import run_properties, run_transfers
from benchmarks.paper.sheets import run_sheets
from benchmarks.paper.superres import run_superres
from benchmarks.paper.surface import run_surface
from benchmarks.paper.tables import Table, markdown
from sgp.cli.console import note
from sgp.cli.exit import FAULT, UsageError, error_text, exit_code
from sgp.pictures import write_overview
from sgp.results import Result, check_output, claim_folder, dumps, read_record, write_record
from sgp.stages.write_profile import write_profile_data

RECORD = "bench.json"
PAGE, FIGURES = "paper.md", "paper.csv"
# The tables of the page; the others are in the folders of their groups.
ON_PAGE = (
    "idempotence",
    "cross_exchange",
    "headline",
    "synthesis_systems",
    "systems_deg",
    "distances",
    "surfaces",
    "systems",
)
# For each group of tables: the function that computes them, and its options with their defaults.
TABLES: Mapping[str, tuple[Callable[..., Comparison], Mapping[str, Any]]] = {
    "properties": (run_properties, {}),
    "transfer": (run_transfers, {"runs": None}),
    "synthesis": (run_sheets, {"seed": 7}),
    "superres": (run_superres, {"seed": 7, "models": None}),
    "surface": (run_surface, {}),
    "costs": (run_costs, {}),
}


_PAGE_PREFACE = (
    "# Measured: the paper's tables\n\n"
    "Written by `python -m benchmarks.paper`; read [the paper's tables](../paper-tables.md) first."
)


class Spent(NamedTuple):
    """What a group took: elapsed and CPU seconds of all processes, and the peak of memory."""

    wall_s: float
    cpu_s: float
    peak_mb: float


def main(words: Sequence[str] | None = None) -> int:
    """Compute groups of tables and write them; return the exit code."""
    parser = command_line(__doc__)
    parser.add_argument("--table", choices=tuple(TABLES), help="one group; all if not given")
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
    parser.add_argument("--force", action="store_true", help="repeat groups that are done")
    options = parser.parse_args(words)
    chosen = tuple(TABLES) if options.table is None else (options.table,)
    names = ("runs", "seed", "models")
    given = {name: getattr(options, name) for name in names if getattr(options, name) is not None}
    for name in given:
        if all(name not in TABLES[group][1] for group in chosen):
            parser.error(f"--{name} is not an option of --table {options.table}")
    try:
        if options.models is not None and not options.models.is_dir():
            raise UsageError(f"{options.models}: no such folder")
        for group in chosen:
            defaults = TABLES[group][1]
            own = {name: value for name, value in given.items() if name in defaults}
            parameters = {"quick": options.quick, **defaults, **own}
            _group(group, options.out / group, parameters, force=options.force)
        _write_page(options.out)
    except Exception as error:
        if exit_code(error) == FAULT:
            raise
        print(f"error: {error_text(error)}", file=sys.stderr)
        return exit_code(error)
    print(f"{options.out / PAGE}")
    return 0


def _at_least(least: int) -> Callable[[str], int]:
    """Return a converter of an option's text to a whole number that refuses smaller ones."""

    def number(text: str) -> int:
        if int(text) < least:
            raise ValueError(text)
        return int(text)

    return number


def _group(group: str, out: Path, parameters: dict[str, Any], *, force: bool) -> None:
    """Compute a group and write its folder, unless the same command has done so."""
    command = f"python -m benchmarks.paper --table {group}"
    if (out / RECORD).exists() and not force:
        before = read_record(out / RECORD)
        if before.command == command and before.parameters == json.loads(dumps(parameters)):
            note(f"{group}: done before, in {out}")
            return
        raise UsageError(
            f"{out} has tables that were made with other options: give another --out, or --force "
            "to replace them"
        )
    check_output(out, parameters.values(), force=force)
    before_mb, cpu_s, wall_s = peak_begins(), _cpu_s(), time.monotonic()
    comparison = TABLES[group][0](**parameters, advance=_Steps())
    peak = max(resident_bytes("VmHWM") - before_mb, 0.0)
    children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024
    spent = Spent(time.monotonic() - wall_s, _cpu_s() - cpu_s, max(peak, children) / 1e6)
    result = _written(comparison, out, spent)
    write_record(out / RECORD, command, parameters, result)
    for notice in result.warnings:
        note(f"{notice.label}: {notice}")
    note(
        f"{group}: {len(comparison.tables)} tables, {spent.wall_s:.0f} s, {spent.cpu_s:.0f} CPU s, "
        f"{spent.peak_mb:.0f} MB"
    )


def _cpu_s() -> float:
    return sum(os.times()[:4])


def _written(comparison: Comparison, out: Path, spent: Spent) -> Result:
    """Write tables, pictures and profiles into a folder."""
    claim_folder(out, RECORD)
    result = Result(warnings=list(comparison.left_out), inputs=comparison.files)
    result.metrics = {"tables": len(comparison.tables), **spent._asdict()}
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
    return result


def _write_page(out: Path) -> None:
    """Write the page and the figures of all groups that are done."""
    took: dict[str, Sequence[float | None]] = {}
    parts, figures = [], io.StringIO()
    writer = csv.writer(figures, lineterminator="\n")
    writer.writerow(("group", "table", "row", "column", "value"))
    for group in TABLES:
        folder = out / group
        if not (folder / RECORD).exists():
            continue
        metrics = read_record(folder / RECORD).metrics
        took[group] = [float(str(metrics[name])) for name in Spent._fields]
        made = json.loads((folder / "tables.json").read_text(encoding="utf-8"))
        for key, table in made.items():
            if key in ON_PAGE:
                parts.append(markdown(Table(**table)))
            for row, values in table["rows"].items():
                for column, value in zip(table["columns"], values, strict=True):
                    number = "" if value is None else f"{value:.6g}"
                    writer.writerow((group, key, row, column, number))
    spent = Table(
        "groups",
        "What the groups took",
        ("seconds", "CPU seconds", "MB"),
        took,
        "CPU seconds are those of all processes and threads, MB is the peak of the largest one.",
    )
    text = "\n\n".join([_PAGE_PREFACE, *parts, markdown(spent)])
    acquisition.write_durably(out / PAGE, f"{text}\n".encode())
    acquisition.write_durably(out / FIGURES, figures.getvalue().encode())


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
