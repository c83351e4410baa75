"""Plant faults in the core modules and count those that no test detects.

    python -m tests.mutation --sample 15 --seed 1
    python -m tests.mutation calibration/spheres/geometry/cone.py --sample 1000
    python -m tests.mutation --planted
    python -m tests.mutation --world 10000

Faults are planted in a temporary copy of the tree. The exit code is 1 if fewer than 90 % are
detected, or if a fault planted by name is not detected. Faults that `survivors.toml` lists as
equivalent, which no test can detect, do not count.
"""

from __future__ import annotations

import argparse
import random
import signal
import sys
import tempfile
from pathlib import Path

from tests.mutation.defects import DEFECTS
from tests.mutation.operators import Mutant, mutants_of
from tests.mutation.planted import PLANTED
from tests.mutation.survivors import Survivors
from tests.mutation.targets import TARGETS
from tests.mutation.trial import Trial

LEAST_SHARE = 0.9


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.mutation",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("modules", nargs="*", metavar="MODULE", help="default: all core modules")
    parser.add_argument("--sample", type=int, default=15, help="number of faults per module")
    parser.add_argument("--seed", type=int, default=1, help="seed of the random choice of faults")
    parser.add_argument("--limit-s", type=float, default=120, help="CPU time per fault in seconds")
    parser.add_argument("--planted", action="store_true", help="plant only the faults with names")
    parser.add_argument(
        "--world",
        type=int,
        metavar="SEEDS",
        help="plant defects of capture code, and count the recordings in virtual time until one "
        "fails",
    )
    args = parser.parse_args()
    unknown = set(args.modules) - set(TARGETS)
    if unknown:
        parser.error(f"not a core module: {', '.join(sorted(unknown))}")
    modules = args.modules or list(TARGETS)
    # So that running tests are ended and the copy is removed.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    with tempfile.TemporaryDirectory(prefix="sgp-mutants-", ignore_cleanup_errors=True) as folder:
        trial = Trial(Path(folder) / "tree")
        if args.world:
            return _in_worlds(trial, args.world)
        if args.planted:
            return _planted(trial, args.limit_s)
        return _drawn(trial, modules, args)


def _planted(trial: Trial, limit_s: float) -> int:
    missed = 0
    for fault in PLANTED:
        text = trial.original(fault.file).replace(fault.old, fault.new)
        outcome = trial.run(fault.file, text, TARGETS[fault.file], limit_s)
        missed += outcome.verdict == "survived"
        print(f"{outcome.verdict:9}{fault.file}: {fault.name}", flush=True)
    return int(missed > 0)


def _in_worlds(trial: Trial, most: int) -> int:
    missed = 0
    for fault in DEFECTS:
        text = trial.original(fault.file).replace(fault.old, fault.new)
        seed = trial.worlds(fault.file, text, most)
        missed += seed is None
        found = f"not in {most}" if seed is None else f"seed {seed}"
        print(f"{found:12}{fault.file}: {fault.name}", flush=True)
    print(f"{len(DEFECTS) - missed} of {len(DEFECTS)} found")
    return int(missed > 0)


def _drawn(trial: Trial, modules: list[str], args: argparse.Namespace) -> int:
    known = Survivors.read()
    killed = total = explained = equivalent = 0
    print(f"{'module':48}{'faults':>7}{'drawn':>7}{'killed':>7}{'known':>7}{'cpu s':>7}")
    for module in modules:
        text, tests = trial.original(module), TARGETS[module]
        plain = trial.run(module, text, tests, args.limit_s)
        if plain.verdict != "survived":
            print(plain.output, file=sys.stderr)
            sys.exit(f"{module}: its tests fail without a planted fault ({plain.verdict})")
        # A much shorter time than the limit is enough to detect an endless loop.
        limit_s = min(args.limit_s, 5 + 3 * plain.seconds)
        every = mutants_of(text)
        draw = random.Random(f"{args.seed} {module}")
        drawn = sorted(
            draw.sample(every, min(args.sample, len(every))), key=lambda mutant: mutant.line
        )
        left = []
        used_s = 0.0
        for mutant in drawn:
            outcome = trial.run(module, mutant.source, tests, limit_s)
            used_s += outcome.seconds
            if outcome.verdict == "survived":
                left.append(mutant)
        reasons = [known.reason(module, mutant) for mutant in left]
        killed += len(drawn) - len(left)
        total += len(drawn)
        explained += sum(reason is not None for reason in reasons)
        equivalent += sum(reason is not None and "equivalent" in reason for reason in reasons)
        print(
            f"{module:48}{len(every):7}{len(drawn):7}{len(drawn) - len(left):7}"
            f"{sum(reason is not None for reason in reasons):7}{used_s:7.0f}",
            flush=True,
        )
        for mutant, reason in zip(left, reasons, strict=True):
            print(_survivor(module, mutant, reason), flush=True)
    share = killed / max(total - equivalent, 1)
    print(
        f"{killed} of {total} killed, {share:.1%} of those that are not equivalent; of the others "
        f"{explained} are listed"
    )
    return int(share < LEAST_SHARE)


def _survivor(module: str, mutant: Mutant, reason: str | None) -> str:
    text = (
        f"  {module}:{mutant.line} {mutant.function}\n    - {mutant.before}\n    + {mutant.after}"
    )
    return text if reason is None else f"{text}\n    listed: {reason}"


if __name__ == "__main__":
    sys.exit(main())
