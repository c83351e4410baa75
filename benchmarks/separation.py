"""What separation and transfer cost, in CPU seconds, copies of the map and memory.

python benchmarks/separation.py [--megapixels 0.3 1 5 20] [--w 5] [--filters gaussian-1 gaussian-8]

CPU seconds are of all threads together, the least of three runs with warm caches; set
NUMBA_NUM_THREADS for their number. "copies" are CPU seconds over those of a copy of the map, "maps"
the growth of peak memory over the map's own bytes (on Linux); the outputs of a separation are two
maps, of a transfer (``combine``) one. "loops alone" is without the check that every normal a call
returns is of unit length.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import cast

# Threads that wait for the next loop by spinning would count as work.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import numba
import numpy as np

from processing import FilterKind, NormalMap, ShapeFilter, combine, separate
from processing._detail.rotation import rotate_from_z

RESET_PEAK = Path("/proc/self/clear_refs")
RUNS = 3


def relief(megapixels: float) -> NormalMap:
    """Waves all over the frame under noise of 6 degrees."""
    height, width = (round((megapixels * 1e6 * side) ** 0.5) for side in (4 / 5, 5 / 4))
    y, x = np.mgrid[:height, :width].astype(np.float32)
    vectors = np.random.default_rng(0).standard_normal((height, width, 3), np.float32) * 0.1
    vectors[..., 0] += 0.4 * np.sin(x / 40)
    vectors[..., 1] += 0.4 * np.sin(y / 50)
    vectors[..., 2] += 1
    vectors /= np.sqrt(np.einsum("ijk,ijk->ij", vectors, vectors))[..., None]
    return NormalMap(vectors, np.ones((height, width), np.bool_))


def resident_bytes(entry: str) -> int:
    status = Path("/proc/self/status").read_text()
    line = next(line for line in status.splitlines() if line.startswith(entry))
    return int(line.split()[1]) * 1024


def measured(work: Callable[[], object]) -> tuple[float, float]:
    """Return the least CPU seconds of some runs and the growth of peak memory in bytes."""
    work()
    seconds, growth = [], []
    for _ in range(RUNS):
        ctypes.CDLL(None).malloc_trim(0)  # memory that is kept for reuse would hide the growth
        before = resident_bytes("VmRSS")
        RESET_PEAK.write_text("5")
        start = time.process_time()
        made = work()
        seconds.append(time.process_time() - start)
        growth.append(resident_bytes("VmHWM") - before)
        del made
    return min(seconds), min(growth)


def cases(given: NormalMap, filters: list[str], w: int) -> dict[str, Callable[[], object]]:
    made: dict[str, Callable[[], object]] = {"copy": given.normals.copy}
    for name in filters:
        kind, order = name.split("-")
        by = ShapeFilter(cast(FilterKind, kind), int(order), w)
        made[f"separate {name}"] = partial(by.split, given)
        made[f"separate {name}, loops alone"] = partial(by.split_vectors, given)
    parts = separate(given, order=1, w=w)
    made["combine"] = partial(combine, parts.shape, parts.detail)
    made["combine, loops alone"] = partial(rotate_from_z, parts.detail.normals, parts.shape.normals)
    return made


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--megapixels", type=float, nargs="+", default=[0.3, 1.0, 5.0, 20.0])
    parser.add_argument("--w", type=int, default=5)
    parser.add_argument(
        "--filters", nargs="+", default=["gaussian-1", "gaussian-8"], help="kind-order"
    )
    options = parser.parse_args()
    print(f"{numba.get_num_threads()} threads, w={options.w}\n")
    print(f"{'':40}{'CPU s':>8}{'ns/px':>8}{'copies':>8}{'maps':>8}")
    for megapixels in options.megapixels:
        given = relief(megapixels)
        copy = 0.0
        for name, work in cases(given, options.filters, options.w).items():
            seconds, peak = measured(work)
            copy = copy or seconds
            print(
                f"{f'{megapixels:g} Mpx {name}':40}{seconds:8.4f}"
                f"{seconds / given.mask.size * 1e9:8.1f}{seconds / copy:8.1f}"
                f"{peak / given.normals.nbytes:8.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
