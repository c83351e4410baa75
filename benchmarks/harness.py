"""Shared parts of the benchmarks: the command line, and the measurement of costs."""

from __future__ import annotations

import argparse
import csv
import ctypes
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import ParamSpec, TypeVar

import numpy as np

from rig.arrays import AnyArray

# Otherwise idle threads of numba's OpenMP pool would spin and count as CPU time.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

# Ends when the parent process ends, for any reason.
_BUSY = """
import os, sys
while os.getppid() == int(sys.argv[1]):
    for _ in range(100_000):
        pass
"""

P = ParamSpec("P")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Cost:
    """Cost of a piece of work.

    Parameters
    ----------
    cpu_s
        CPU seconds of all threads.
    wall_s
        Wall time, seconds.
    peak_bytes
        Peak of the resident memory above that before the work; NaN if the system does not report
        it.
    """

    cpu_s: float
    wall_s: float
    peak_bytes: float

    @property
    def peak_mb(self) -> float:
        return self.peak_bytes / 1e6


class _Help(argparse.RawDescriptionHelpFormatter, argparse.ArgumentDefaultsHelpFormatter):
    pass


def command_line(doc: str | None) -> argparse.ArgumentParser:
    """Return a parser whose help page is the docstring of a benchmark and the options' defaults."""
    return argparse.ArgumentParser(description=doc, formatter_class=_Help)


class Table:
    """A table that is printed row by row, and written to a file.

    Parameters
    ----------
    out
        The file (.csv); None to print only.
    """

    def __init__(self, out: Path | None) -> None:
        self._out, self._rows = out, list[dict[str, str]]()

    def add(self, row: dict[str, str]) -> None:
        """Print a row; the first one has the columns of all."""
        widths = [max(len(name), 8) + 1 for name in row]
        if not self._rows:
            self._print(list(row), widths)
        self._print(list(row.values()), widths)
        self._rows.append(row)
        if self._out is not None:
            with self._out.open("w", encoding="utf-8", newline="") as file:
                writer = csv.DictWriter(file, list(row), lineterminator="\n")
                writer.writeheader()
                writer.writerows(self._rows)

    def _print(self, values: list[str], widths: list[int]) -> None:
        line = "".join(f"{value:>{width}}" for value, width in zip(values, widths, strict=True))
        print(line, flush=True)


def busy_option(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--busy``, the number of processes for `busy`."""
    parser.add_argument(
        "--busy", type=int, default=0, help="number of processes that compute all the time"
    )


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Keep ``count`` processes computing at normal priority inside the ``with``."""
    words = [sys.executable, "-c", _BUSY, str(os.getpid())]
    started: list[subprocess.Popen[bytes]] = []
    try:
        while len(started) < count:
            started.append(subprocess.Popen(words, stdin=subprocess.DEVNULL))
        yield
    finally:
        for process in started:
            process.kill()
            process.wait()


def measured(work: Callable[[], Result], runs: int = 1) -> tuple[Cost, Result]:
    """Run some work; return the minimum cost over the runs, and the result of the last run."""
    costs: list[tuple[float, float, float]] = []
    results: list[Result] = []
    for _ in range(runs):
        results.clear()  # frees the result of the previous run
        before = peak_begins()
        cpu, wall = time.process_time(), time.perf_counter()
        results.append(work())
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        costs.append((cpu, wall, resident_bytes("VmHWM") - before))
    return Cost(*map(min, zip(*costs, strict=True))), results[0]


def copy_s(values: AnyArray) -> float:
    """Return the CPU seconds for copying an array, a yardstick for work limited by memory.

    The copy is written to allocated memory; requesting it from the system would take longer.
    """
    target = np.zeros_like(values)
    spent = []
    for _ in range(10):
        begun = time.process_time()
        np.copyto(target, values)
        spent.append(time.process_time() - begun)
    return min(spent)


def alone(work: Callable[P, Result], *args: P.args, **kwargs: P.kwargs) -> Result:
    """Call a function of the benchmark in a process of its own.

    In the same process, memory that was freed but kept would hide the memory of the next work.
    """
    # Freed blocks are returned to the system at once. BLAS uses one thread, because idle threads
    # would spin and cost scipy's solvers many times their work on vectors.
    # The new process starts without the working directory on its search path.
    own = {
        "MALLOC_MMAP_THRESHOLD_": "65536",
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONSAFEPATH": "1",
    }
    before = os.environ.copy()
    os.environ |= own
    try:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            return pool.submit(work, *args, **kwargs).result()
    finally:
        # Later processes of the caller are not those of a benchmark.
        for name in own:
            os.environ.pop(name)
        os.environ |= {name: before[name] for name in own if name in before}


def resident_bytes(entry: str = "VmRSS") -> float:
    """Return the resident memory of this process, or its peak; NaN if it is not reported."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return float("nan")
    return next(float(line.split()[1]) for line in lines if line.startswith(entry)) * 1024


@contextmanager
def largest(read: Callable[[], int], every_s: float) -> Iterator[list[int]]:
    """Yield a list whose only value is the largest that was read so far inside the ``with``."""
    found, ended = [read()], threading.Event()

    def watch() -> None:
        while not ended.wait(every_s):
            found[0] = max(found[0], read())

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield found
    finally:
        ended.set()
        watcher.join()
        found[0] = max(found[0], read())


def peak_begins() -> float:
    """Reset the system's peak of the resident memory; return the memory that is resident now."""
    try:
        # Return freed memory to the system, because it would hide memory that is used later.
        ctypes.CDLL(None).malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except (OSError, AttributeError):
        return float("nan")
    return resident_bytes()
