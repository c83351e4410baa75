"""Recordings in virtual time: many with faults from seeds, or one step by step."""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from acquisition import DataError
from simulator.world.schedule import Schedule
from simulator.world.trial import run, run_seed

_EXAMPLES = """examples:
  python benchmarks/world.py --count 1000
  python benchmarks/world.py --seed 17 --log
  python benchmarks/world.py --seed 17 --shrink
  python benchmarks/world.py --schedule 17.json --log"""


def _many(first: int, count: int, workers: int, *, stop: bool) -> int:
    began_s = time.monotonic()
    met: Counter[str] = Counter()
    parts: Counter[str] = Counter()
    failed, programs, steps, virtual_s = [], 0, 0, 0.0
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for number, outcome in enumerate(
            pool.map(run_seed, range(first, first + count), chunksize=8), 1
        ):
            met.update(event.kind for event in outcome.met)
            programs, steps = programs + outcome.programs, steps + outcome.steps
            virtual_s += outcome.ended_s
            parts.update(outcome.seconds)
            if outcome.violations:
                failed.append(outcome.schedule.seed)
                for text in outcome.violations:
                    print(f"seed {outcome.schedule.seed}: {text}")
                print(f"  python benchmarks/world.py --seed {outcome.schedule.seed} --log")
                if stop:
                    pool.shutdown(cancel_futures=True)
                    return 1
            if sys.stderr.isatty() or number % 500 == 0:
                print(f"\r{number} of {count}", end="", file=sys.stderr)
    seconds = time.monotonic() - began_s
    print(
        f"\n{count} schedules, {programs} programs, {steps} steps, {virtual_s / 3600:.1f} h of "
        f"virtual time in {seconds:.1f} s ({1000 * seconds / count:.1f} ms each): "
        f"{len(failed)} with violations"
    )
    for part, spent_s in parts.most_common():
        print(f"{1000 * spent_s / count:8.1f} ms  {part}")
    for kind, times in sorted(met.items()):
        print(f"{times:8d}  {kind}")
    return 1 if failed else 0


def main() -> int:
    """Entry point; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python benchmarks/world.py",
        description="Run recordings in virtual time with faults from a seed, and check that "
        "nothing is lost, attributed to a wrong LED, or left lit.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--count", type=int, default=100, help="number of seeds [100]")
    parser.add_argument("--first", type=int, default=0, help="first seed [0]")
    parser.add_argument("--workers", type=int, default=2, help="processes [2]")
    parser.add_argument("--stop", action="store_true", help="end after the first violation")
    parser.add_argument("--seed", type=int, help="run only this seed")
    parser.add_argument("--schedule", type=Path, help="run only the schedule of this file")
    parser.add_argument("--log", action="store_true", help="print every step")
    parser.add_argument(
        "--shrink", action="store_true", help="reduce the faults to those that are needed to fail"
    )
    options = parser.parse_args()
    if options.count < 1 or options.workers < 1:
        parser.error("--count and --workers must be at least 1")
    if options.seed is None and options.schedule is None:
        return _many(options.first, options.count, options.workers, stop=options.stop)
    try:
        schedule = Schedule.drawn(options.seed or 0)
        if options.schedule is not None:
            schedule = Schedule.read(options.schedule)
    except DataError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if options.shrink:
        schedule = schedule.shrunk(lambda fewer: bool(run(fewer).violations))
        print(schedule.to_json())
    outcome = run(schedule, log=options.log)
    print(f"{outcome.programs} programs, {outcome.steps} steps, {outcome.ended_s:.3f} s")
    for text in outcome.violations:
        print(f"violation: {text}")
    return 1 if outcome.violations else 0


if __name__ == "__main__":
    sys.exit(main())
