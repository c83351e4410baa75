"""Inputs and events that programs of this field treat wrongly, and what this program makes of each.

    python benchmarks/true_to_the_input.py                     # all cases, as a table
    python benchmarks/true_to_the_input.py images --only auto  # some of one module
    python benchmarks/true_to_the_input.py --checkout OLD --before   # store those of another one
    python benchmarks/true_to_the_input.py --out docs/measured/true-to-the-input.csv

The modules of `true_to_input/` contain the cases. The outcome of a case is right, applied and
stated, or refused by name; vague and wrong are faults, and the exit code is then 1. The outcomes
before the repair are in `true_to_input/before/`, as ``--before`` stored them.
"""

from __future__ import annotations

import argparse
import csv
import importlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from true_to_input.case import GOOD, Case, Outcome, emptied

HERE = Path(__file__).parent
FOLDER = HERE / "true_to_input"
MODULES = sorted(path.stem for path in FOLDER.glob("*_cases.py"))
SECTIONS = {1: "images", 2: "values", 3: "results", 4: "camera", 5: "installation"}
# Characters of an outcome that are printed and stored.
_TEXT = 150


def cases_of(module: str) -> tuple[Case, ...]:
    """Return the cases of a module by its name with or without ``_cases``."""
    name = module if module.endswith("_cases") else f"{module}_cases"
    cases: tuple[Case, ...] = importlib.import_module(f"true_to_input.{name}").CASES
    return cases


def outcome_of(case: Case, folder: Path) -> Outcome:
    """Run a case in a folder of its own; an exception of the program is a wrong outcome."""
    place = emptied(folder / case.name)
    try:
        kind, text = case.run(place)
    except Exception as error:  # noqa: BLE001 - whatever happens is the outcome
        kind, text = "wrong", f"{type(error).__name__}: {error}"
    return Outcome(kind, text.replace(f"{place}/", "").replace(str(place), "."))


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("modules", nargs="*", help=f"of {', '.join(MODULES)}; default: all")
    parser.add_argument("--only", default="", help="cases whose names contain this")
    parser.add_argument("--checkout", type=Path, help="folder of another revision of the program")
    parser.add_argument(
        "--before", action="store_true", help="store the outcomes as those before the repair"
    )
    parser.add_argument("--out", type=Path, help="also write the table to this CSV file")
    parser.add_argument("--work", type=Path, help="keep the inputs and results in this folder")
    given = parser.parse_args()
    if given.checkout is not None:
        # The packages are those of the other checkout from the start of the process.
        words = [word for word in sys.argv[1:] if word not in ("--checkout", str(given.checkout))]
        environment = {**os.environ, "PYTHONPATH": str(given.checkout.resolve())}
        return subprocess.run(
            [sys.executable, __file__, *words], env=environment, check=False
        ).returncode
    rows: list[tuple[Case, Outcome, Outcome]] = []
    with tempfile.TemporaryDirectory() as scratch:
        for module in given.modules or MODULES:
            rows += _run(module, given.only, given.work or Path(scratch), before=given.before)
    counts = Counter(outcome.kind for _, _, outcome in rows)
    print(", ".join(f"{counts[kind]} {kind}" for kind in (*GOOD, "vague", "wrong")))
    if given.out is not None:
        _write_table(given.out, rows)
    return 1 if counts["vague"] or counts["wrong"] else 0


def _run(
    module: str, only: str, work: Path, *, before: bool
) -> list[tuple[Case, Outcome, Outcome]]:
    store = FOLDER / "before" / f"{module.removesuffix('_cases')}.json"
    earlier = json.loads(store.read_text(encoding="utf-8")) if store.exists() else {}
    rows = []
    for case in cases_of(module):
        if only not in case.name:
            continue
        start = time.monotonic()
        outcome = outcome_of(case, work / module)
        if before:
            earlier[case.name] = [outcome.kind, outcome.text[:_TEXT]]
        was = Outcome(*earlier.get(case.name, ("", "not measured")))
        rows.append((case, was, outcome))
        took = f"{time.monotonic() - start:.1f} s"
        print(
            f"{case.section} {case.name:28s} {outcome.kind:18s} {took:>7s}  {outcome.text[:_TEXT]}",
            flush=True,
        )
    if before:
        store.parent.mkdir(exist_ok=True)
        store.write_text(json.dumps(earlier, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return rows


def _write_table(path: Path, rows: list[tuple[Case, Outcome, Outcome]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(("section", "case", "reported", "right", "before", "", "now", ""))
        for case, was, now in sorted(rows, key=lambda row: row[0].section):
            reported = "yes" if case.listed else "further member"
            outcomes = (was.kind, _cell(was.text), now.kind, _cell(now.text))
            table.writerow((SECTIONS[case.section], case.name, reported, case.right, *outcomes))


def _cell(text: str) -> str:
    return " ".join(text.split())[:_TEXT]


if __name__ == "__main__":
    raise SystemExit(main())
