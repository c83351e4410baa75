"""Imperfect recordings of known objects: what an imperfection does, and what the program says.

Each scene is recorded as it is, and then with one imperfection at a time at three strengths: scenes
of the simulator, and objects of DiLiGenT and of the University of Washington from the folder that
SGP_DATA names. Harm is the mean angle to the true normals beyond that of the clean recording; an
imperfection is harmful if this exceeds 1 degree and the standard deviation that is stated of the
clean result. "named" counts verdicts that name it among the first two causes or the alternatives of
these. Where the images do not distinguish two causes, either name is right.

Rows that are in the file are not computed again. Seeds below 1000 were used for development.

    SGP_DATA=data python -m benchmarks.imperfections --out docs/measured/imperfections.csv
    SGP_DATA=data python -m benchmarks.imperfections --scenes coin head --cases room_light drift
"""

from __future__ import annotations

import sys
import time
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks.harness import command_line
from benchmarks.imperfections.cases import CASES, NONE
from benchmarks.imperfections.real import REAL
from benchmarks.imperfections.recordings import Recording
from benchmarks.imperfections.scenes import SCENES, SIZE, random_scene, scene
from benchmarks.imperfections.summary import summary
from benchmarks.imperfections.table import Key, Row, Table, cases_of
from benchmarks.imperfections.trials import Trial

Tried = list[tuple[str, str]]
RANDOM = "random"
_CLEAN = (NONE, "0")


def main(words: Sequence[str] | None = None) -> int:
    """Fill the table and print its summary; return the exit code."""
    parser = command_line(__doc__)
    parser.add_argument("--out", type=Path, default=Path("imperfections.csv"), help="the table")
    parser.add_argument("--scenes", nargs="*", help="of the simulator; default: all")
    parser.add_argument("--real", nargs="*", help="real recordings; default: all")
    parser.add_argument("--cases", nargs="*", default=list(CASES), help="imperfections")
    parser.add_argument("--strengths", type=int, default=3, help="strengths of each imperfection")
    parser.add_argument("--first-seed", type=int, default=1000, help="first seed")
    parser.add_argument("--seeds", type=int, default=1, help="number of seeds of each scene")
    parser.add_argument("--clean", type=int, default=0, help="number of random clean recordings")
    parser.add_argument("--pairs", type=int, default=0, help="pairs of imperfections of each scene")
    parser.add_argument("--size", type=int, nargs=2, default=SIZE, help="width and height")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="end after this time")
    parser.add_argument("--summary", action="store_true", help="only print the summary")
    options = parser.parse_args(words)
    table = Table(options.out)
    ends = time.monotonic() + 60 * options.minutes
    if not options.summary:
        for name, seed, record, tried in _recordings(options):
            keys = [Key(name, str(seed), *one) for one in tried]
            if not all(key in table for key in keys):
                _fill(table, keys, record(), ends)
            if time.monotonic() > ends:
                break
    print(*summary(table), sep="\n")
    return 0


def _recordings(options: Namespace) -> Iterator[tuple[str, int, Callable[[], Recording], Tried]]:
    """Yield name and seed of each recording, how it is made, and what is tried on it."""
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    for seed, name in product(seeds, SCENES if options.scenes is None else options.scenes):
        yield name, seed, partial(scene, name, seed, tuple(options.size)), _tried(options, seed)
    for name in REAL if options.real is None else options.real:
        yield name, 0, REAL[name], _tried(options, 0)
    for seed in range(options.first_seed, options.first_seed + options.clean):
        yield RANDOM, seed, partial(random_scene, seed), [_CLEAN]


def _fill(table: Table, keys: list[Key], recording: Recording, ends: float) -> None:
    """Add the rows of a recording that are missing, the clean one first."""
    keys = [key for key in keys if all(case.applies_to(recording) for case in cases_of(key))]
    if all(key in table for key in keys):
        return
    trial = Trial(recording)
    for key in keys:
        if time.monotonic() > ends:
            return
        if key in table and key.case != NONE:  # the others are compared with the clean result
            continue
        changed = recording
        for case, strength in zip(cases_of(key), key.strength.split("+"), strict=True):
            changed = case.change(changed, float(strength))
        row = Row.of(key, recording, trial.outcome(changed))
        if key not in table:
            table.add(row)
        print(row, flush=True)


def _tried(options: Namespace, seed: int) -> Tried:
    """Return the imperfections and their strengths, the clean recording first."""
    rng = np.random.default_rng([seed, 2])
    tried = [_CLEAN]
    for name in options.cases:
        strengths = CASES[name].strengths[: options.strengths]
        tried += [(name, f"{strength:g}") for strength in strengths if name != NONE]
    others = [name for name in CASES if name != NONE]
    for _ in range(options.pairs):
        pair = [str(name) for name in rng.choice(others, 2, replace=False)]
        tried.append(("+".join(pair), "+".join(f"{CASES[n].strengths[0]:g}" for n in pair)))
    return tried


if __name__ == "__main__":
    sys.exit(main())
