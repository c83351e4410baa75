"""Measure time and memory of transfer methods in a separate process.

The process is separate because freed memory that a process keeps hides the memory of the next run.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

import processing
import rig
from benchmarks.harness import peak_begins, resident_bytes
from benchmarks.paper.peers import dspl, lapl
from benchmarks.paper.peers.mesh import GridMesh
from benchmarks.paper.peers.surfaces import MeshTask, Surfaces
from rig.arrays import Bool, Float32

Method = Literal["DSPL", "LAPL", "LAPL, direct solver", "normals", "normals, order 8"]
# The methods that the tables compare. The direct solver gives the same result as LAPL.
METHODS: tuple[Method, ...] = ("DSPL", "LAPL", "normals", "normals, order 8")
_ORDERS = {"normals": 1, "normals, order 8": 8}

# Largest number of memory measurements; memory hardly varies.
_MEMORY_RUNS = 3


# A mesh method: it prepares a target and returns the transfer of a source's vertices.
Fit = Callable[[MeshTask], Callable[[Float32], Float32]]
PEERS: Mapping[str, Fit] = {
    dspl.PEER.name: dspl.PEER.fit,
    lapl.PEER.name: lapl.PEER.fit,
    "LAPL, direct solver": partial(lapl.fit, factorise=lapl.superlu),
}


def in_normals(
    source: processing.NormalMap, target: processing.NormalMap, order: int = 1
) -> processing.NormalMap:
    """Transfer detail in the normal domain, as the method "normals"."""
    by = processing.ShapeFilter(order=order)
    return processing.combine(by.shape(target), processing.separate(source, shape_filter=by).detail)


IN_NORMALS: Mapping[
    str, Callable[[processing.NormalMap, processing.NormalMap], processing.NormalMap]
] = {name: partial(in_normals, order=order) for name, order in _ORDERS.items()}


@dataclass(frozen=True, eq=False)
class Measured:
    """Result, time and memory of a transfer.

    Parameters
    ----------
    normal_map
        Result of the transfer.
    cpu_s
        CPU seconds of all threads for each run, from the two maps or the two surfaces to the
        result.
    again_cpu_s
        The same for repeated runs, which reuse the data that depend on the target only: its shape
        or its smooth base, and factors of a matrix.
    peak_bytes
        Peak of resident memory above the memory with the inputs loaded, for some runs as in
        `cpu_s`; empty if the system does not report it.
    """

    normal_map: processing.NormalMap
    cpu_s: tuple[float, ...]
    again_cpu_s: tuple[float, ...]
    peak_bytes: tuple[int, ...]


def measure(
    methods: Sequence[str],
    source: processing.NormalMap,
    target: processing.NormalMap,
    *,
    region: Bool | None = None,
    w: int = 5,
    runs: int = 1,
) -> dict[str, Measured]:
    """Transfer detail with several methods in a new process, one after another, with warm caches.

    The mesh methods receive the surfaces that are integrated from the normal maps, with one vertex
    per pixel; the time of this integration does not count. "normals" is separation with the paper's
    filter and its transfer.

    Parameters
    ----------
    methods
        Names from `Method`.
    source, target
        Maps of the same size; the source is already placed over the target.
    region
        ``(H, W)`` bool, for the mesh methods: the part that receives detail. Default: all.
    w
        Half width of the paper's filter.
    runs
        Number of runs.
    """
    from simulator.bench import OwnedFolder  # not in the process that is measured

    with closing(OwnedFolder("sgp-measure-")) as folder:
        inputs, outputs = folder.path / "given.npz", folder.path / "made.npy"
        mask = source.mask & target.mask
        np.savez(
            inputs,
            source=source.normals,
            target=target.normals,
            mask=mask,
            region=mask if region is None else region & mask,
            whole=region is None,
        )
        call = rig.processes.module_command(__name__, inputs, outputs, w, runs, *methods)
        # Idle threads sleep, as in `sgp`, and BLAS uses one thread; otherwise spinning threads
        # would count as CPU time.
        environment = os.environ | {"OMP_WAIT_POLICY": "passive", "OPENBLAS_NUM_THREADS": "1"}
        done = subprocess.run(call, check=True, env=environment, stdout=subprocess.PIPE, text=True)
        figures = json.loads(done.stdout)
        results = np.load(outputs)
    return {
        method: Measured(
            processing.NormalMap(normals, mask),
            **{name: tuple(values) for name, values in figures[method].items()},
        )
        for method, normals in zip(methods, results, strict=True)
    }


class _Bench:
    """The inputs of all methods; `prepare` and the function that it returns are measured."""

    def __init__(
        self,
        source: processing.NormalMap,
        target: processing.NormalMap,
        region: Bool | None,
        w: int,
    ) -> None:
        self._source, self._target, self._w = source, target, w
        self._surfaces = Surfaces.of(source, target)
        self._region = None if region is None else region[self._surfaces.mesh.mask]

    def prepare(self, method: str) -> Callable[[], processing.NormalMap | Float32]:
        """Do the computations that depend on the target only; return a function for the rest."""
        if method in PEERS:
            surfaces = self._surfaces
            mesh = GridMesh(surfaces.mesh.mask, surfaces.mesh.faces)  # with an empty cache
            put = PEERS[method](MeshTask(surfaces.target, mesh, self._region, self._w))
            return partial(put, surfaces.source)
        order = _ORDERS[method]
        by = processing.ShapeFilter(order=order, w=self._w)
        shape = by.shape(self._target)
        return lambda: processing.combine(
            shape, processing.separate(self._source, shape_filter=by).detail
        )

    def normals(self, result: processing.NormalMap | Float32) -> Float32:
        if isinstance(result, processing.NormalMap):
            return result.normals
        return self._surfaces.read(result, self._target).normals


def timed(work: Callable[[], Any], runs: int) -> list[float]:
    cpu_s = []
    for _ in range(runs):
        begun = time.process_time()
        work()
        cpu_s.append(time.process_time() - begun)
    return cpu_s


def peaks(work: Callable[[], Any], runs: int) -> list[int]:
    """Measure memory in separate runs, since requesting pages from the system costs time."""
    peaks = []
    for _ in range(runs):
        before = peak_begins()
        work()
        peaks.append(resident_bytes("VmHWM") - before)
    return [int(peak) for peak in peaks if not math.isnan(peak)]


def cost(work: Callable[[], Any]) -> list[float | None]:
    """Return CPU time and elapsed time of one run in s, and the peak of memory of another in MB."""
    cpu, wall = time.process_time(), time.perf_counter()
    work()
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    measured = peaks(work, 1)
    return [cpu, wall, measured[0] / 1e6 if measured else None]


def run_methods(arguments: Sequence[str]) -> None:
    """Run the measurements in the process that `measure` starts.

    Parameters
    ----------
    arguments
        Command line arguments, as `measure` writes them.
    """
    inputs, outputs, w, runs = (
        Path(arguments[0]),
        arguments[1],
        int(arguments[2]),
        int(arguments[3]),
    )
    with np.load(inputs) as arrays:
        mask = arrays["mask"]
        source, target = (
            processing.NormalMap(np.where(mask[..., None], arrays[name], 0), mask)
            for name in ("source", "target")
        )
        region = None if arrays["whole"] else arrays["region"]
    # Large enough that every parallel kernel runs on several threads.
    flat = processing.NormalMap(
        np.tile(np.array([0, 0, 1], np.float32), (140, 140, 1)), np.ones((140, 140), bool)
    )
    warm = _Bench(flat, flat, None, w)
    bench = _Bench(source, target, region, w)
    figures, results = {}, []
    for method in arguments[4:]:
        warm.prepare(method)()

        def first(method: str = method) -> processing.NormalMap | Float32:
            return bench.prepare(method)()

        prepared = bench.prepare(method)
        cpu_s, again_cpu_s = timed(first, runs), timed(prepared, runs)
        results.append(bench.normals(prepared()))
        del prepared
        figures[method] = {
            "cpu_s": cpu_s,
            "again_cpu_s": again_cpu_s,
            "peak_bytes": peaks(first, min(runs, _MEMORY_RUNS)),
        }
    np.save(outputs, np.stack(results))
    print(json.dumps(figures))


if __name__ == "__main__":
    run_methods(sys.argv[1:])
