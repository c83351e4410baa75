"""What the benchmarks share: their command line, and what a piece of work costs."""

from __future__ import annotations

import argparse
import ctypes
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np
import numpy.typing as npt

# Idle threads of numba's OpenMP pool would spin, and count as work.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

# Ends with the process that started it, however that one ends.
_BUSY = """
import os, sys
while os.getppid() == int(sys.argv[1]):
    for _ in range(100_000):
        pass
"""

P = ParamSpec("P")
Made = TypeVar("Made")


@dataclass(frozen=True)
class Cost:
    """What a piece of work took.

    Parameters
    ----------
    cpu_s
        Of all threads.
    wall_s
        By the clock.
    peak_bytes
        Resident memory at its peak above what was there before; NaN where the system does not tell.
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
    """Return a parser whose help page is a benchmark's docstring, with defaults of the options."""
    return argparse.ArgumentParser(description=doc, formatter_class=_Help)


def busy_option(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--busy``, the number of processes for `busy`."""
    parser.add_argument(
        "--busy", type=int, default=0, help="processes that compute without pause meanwhile"
    )


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Keep so many processes computing without pause, at normal priority, inside the ``with``."""
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


def measured(work: Callable[[], Made], runs: int = 1) -> tuple[Cost, Made]:
    """Do some work; return the least that one of its runs took, and what the last one made."""
    costs = []
    for _ in range(runs):
        made = None  # what the run before made is not resident in this one
        before = _peak_begins()
        cpu, wall = time.process_time(), time.perf_counter()
        made = work()
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        costs.append((cpu, wall, resident_bytes("VmHWM") - before))
    return Cost(*map(min, zip(*costs, strict=True))), made


def copy_s(values: npt.NDArray[Any]) -> float:
    """Return the CPU seconds of copying an array, the yardstick of what goes through memory.

    The copy goes to memory that is there already; asking the system for it would take longer.
    """
    target = np.zeros_like(values)
    spent = []
    for _ in range(10):
        begun = time.process_time()
        np.copyto(target, values)
        spent.append(time.process_time() - begun)
    return min(spent)


def alone(work: Callable[P, Made], *args: P.args, **kwargs: P.kwargs) -> Made:
    """Call a function of the benchmark in a process of its own.

    Memory that a process has freed and kept would hide what the next work takes.
    """
    # Freed blocks go back to the system at once. Threads of BLAS would spin, as those of OpenMP: on
    # vectors that costs scipy's solvers many times their work.
    # And the new process starts without the working directory on its search path.
    os.environ |= {
        "MALLOC_MMAP_THRESHOLD_": "65536",
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONSAFEPATH": "1",
    }
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(work, *args, **kwargs).result()


def resident_bytes(entry: str = "VmRSS") -> float:
    """Return the memory that this process holds, or held at most; NaN where nothing tells."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return float("nan")
    return next(float(line.split()[1]) for line in lines if line.startswith(entry)) * 1024


def _peak_begins() -> float:
    """Make the system count the peak of resident memory anew; return what is resident now."""
    try:
        # What was freed goes back to the system, else it would hide what is used from here on.
        ctypes.CDLL(None).malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except (OSError, AttributeError):
        return float("nan")
    return resident_bytes()
