"""Ways of transferring detail, timed and weighed in a process of their own.

A process of its own, because freed memory that stays with a process hides what the next run takes.
"""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
import numpy.typing as npt

from processing import NormalMap, ShapeFilter, combine, separate
from rig import module_command
from sgp._paper.displacement import Displacement
from sgp._paper.laplacian import LaplacianEditing, superlu
from sgp._paper.mesh import Float, GridMesh
from sgp._paper.surfaces import Surfaces

Method = Literal["DSPL", "LAPL", "LAPL, direct solver", "normals", "normals, order 8"]
# Those that the tables compare. The direct solver gives what LAPL gives.
METHODS: tuple[Method, ...] = ("DSPL", "LAPL", "normals", "normals, order 8")
_ORDERS = {"normals": 1, "normals, order 8": 8}
Mask = npt.NDArray[np.bool_]

# How often memory is measured at most: it hardly varies.
_MEMORY_RUNS = 3


class Peer(Protocol):
    """A mesh method that has done what depends on its target alone."""

    def put(self, source: Float) -> Float:
        """Put a source's detail onto the target; ``(V, 3)`` vertices."""


MakePeer = Callable[[Float, GridMesh, Mask | None, int], Peer]
PEERS: Mapping[str, MakePeer] = {
    "DSPL": Displacement,
    "LAPL": LaplacianEditing,
    "LAPL, direct solver": partial(LaplacianEditing, factorise=superlu),
}


def in_normals(source: NormalMap, target: NormalMap, order: int = 1) -> NormalMap:
    """Transfer in the normal domain, as "normals" does it."""
    return combine(separate(target, order=order).shape, separate(source, order=order).detail)


IN_NORMALS: Mapping[str, Callable[[NormalMap, NormalMap], NormalMap]] = {
    name: partial(in_normals, order=order) for name, order in _ORDERS.items()
}


@dataclass(frozen=True, eq=False)
class Measured:
    """A transfer's result and what it took.

    Parameters
    ----------
    normal_map
        The result.
    cpu_s
        Of each run, from the two maps or the two surfaces to the result: CPU seconds of all
        threads.
    again_cpu_s
        Of each run where what depends on the target alone was kept from an earlier transfer: its
        shape or its smooth base, factors of a matrix.
    peak_bytes
        Resident memory at its peak above what was there with the inputs loaded, of some runs as
        for `cpu_s`; empty where the system does not tell.
    """

    normal_map: NormalMap
    cpu_s: tuple[float, ...]
    again_cpu_s: tuple[float, ...]
    peak_bytes: tuple[int, ...]


def measure(
    methods: Sequence[str],
    source: NormalMap,
    target: NormalMap,
    *,
    region: Mask | None = None,
    w: int = 5,
    runs: int = 1,
    script: Path | None = None,
) -> dict[str, Measured]:
    """Transfer detail by some methods in a new process, one after the other, with warm caches.

    The mesh methods are given the surfaces that the normal maps integrate to, pixel on pixel; how
    long that integration takes does not count. "normals" is separation by the paper's filter and
    its transfer.

    Parameters
    ----------
    methods
        Of `Method`, or what `program` knows besides.
    source, target
        Maps of one size, the source laid over the target.
    region
        ``(H, W)`` bool, for the mesh methods: the part that receives detail. Default: all.
    w
        Half width of the paper's filter.
    runs
        How often.
    script
        A script that calls `run_methods`. Default: this module.
    """
    from simulator import OwnedFolder  # not in the process that is measured

    with closing(OwnedFolder("sgp-measure-")) as folder:
        given, made = folder.path / "given.npz", folder.path / "made.npy"
        mask = source.mask & target.mask
        np.savez(
            given,
            source=source.normals,
            target=target.normals,
            mask=mask,
            region=mask if region is None else region & mask,
            whole=region is None,
        )
        arguments = (given, made, w, runs, *methods)
        if script is None:
            call = module_command(__name__, *arguments)
        else:
            call = [sys.executable, "-P", str(script), *map(str, arguments)]
        # Idle threads sleep, as in `sgp`, and BLAS has one: else their spinning counts as work.
        environment = os.environ | {"OMP_WAIT_POLICY": "passive", "OPENBLAS_NUM_THREADS": "1"}
        done = subprocess.run(call, check=True, env=environment, stdout=subprocess.PIPE, text=True)
        figures = json.loads(done.stdout)
        results = np.load(made)
    return {
        method: Measured(
            NormalMap(normals, mask),
            **{name: tuple(values) for name, values in figures[method].items()},
        )
        for method, normals in zip(methods, results, strict=True)
    }


class _Bench:
    """The inputs of every method; what `prepare` and what it returns do is what is measured."""

    def __init__(
        self,
        source: NormalMap,
        target: NormalMap,
        region: Mask | None,
        w: int,
        peers: Mapping[str, MakePeer],
    ) -> None:
        self._source, self._target, self._w, self._peers = source, target, w, peers
        self._surfaces = Surfaces.of(source, target)
        self._region = None if region is None else region[self._surfaces.mesh.mask]

    def prepare(self, method: str) -> Callable[[], NormalMap | Float]:
        """Do what depends on the target alone; the rest is left to the call."""
        if method in self._peers:
            given = self._surfaces
            mesh = GridMesh(given.mesh.mask, given.mesh.faces)  # has nothing in store
            peer = self._peers[method](given.target, mesh, self._region, self._w)
            return partial(peer.put, given.source)
        order = _ORDERS[method]
        shape = ShapeFilter("gaussian", order, self._w).shape(self._target)
        return lambda: combine(shape, separate(self._source, order=order, w=self._w).detail)

    def normals(self, result: NormalMap | Float) -> Float:
        if isinstance(result, NormalMap):
            return result.normals
        return self._surfaces.read(result, self._target).normals


def _resident_bytes(entry: str) -> int:
    status = Path("/proc/self/status").read_text(encoding="ascii")
    line = next(line for line in status.splitlines() if line.startswith(entry))
    return int(line.split()[1]) * 1024


def _peak_begins() -> int | None:
    """Make the system count the peak of resident memory anew; returns what is resident now."""
    try:
        # What earlier runs freed goes back to the system, else it would hide what this one uses.
        ctypes.CDLL(None).malloc_trim(0)
        resident = _resident_bytes("VmRSS")
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except (OSError, AttributeError):
        return None
    return resident


def _timed(work: Callable[[], Any], runs: int) -> list[float]:
    cpu_s = []
    for _ in range(runs):
        begun = time.process_time()
        work()
        cpu_s.append(time.process_time() - begun)
    return cpu_s


def _peaks(work: Callable[[], Any], runs: int) -> list[int]:
    """Measure memory in runs of their own: taking pages from the system anew costs time."""
    peaks = []
    for _ in range(runs):
        before = _peak_begins()
        work()
        if before is not None:
            peaks.append(_resident_bytes("VmHWM") - before)
    return peaks


def run_methods(arguments: Sequence[str], peers: Mapping[str, MakePeer] = PEERS) -> None:
    """Be the process that `measure` starts.

    Parameters
    ----------
    arguments
        As `measure` writes them.
    peers
        Every mesh method by name.
    """
    given, made, w, runs = Path(arguments[0]), arguments[1], int(arguments[2]), int(arguments[3])
    with np.load(given) as arrays:
        mask = arrays["mask"]
        source, target = (
            NormalMap(np.where(mask[..., None], arrays[name], 0), mask)
            for name in ("source", "target")
        )
        region = None if arrays["whole"] else arrays["region"]
    # So large that every kernel runs on many threads too, as far as it has them.
    flat = NormalMap(
        np.tile(np.array([0, 0, 1], np.float32), (140, 140, 1)), np.ones((140, 140), bool)
    )
    warm = _Bench(flat, flat, None, w, peers)
    bench = _Bench(source, target, region, w, peers)
    figures, results = {}, []
    for method in arguments[4:]:
        warm.prepare(method)()

        def first(method: str = method) -> NormalMap | Float:
            return bench.prepare(method)()

        prepared = bench.prepare(method)
        cpu_s, again_cpu_s = _timed(first, runs), _timed(prepared, runs)
        results.append(bench.normals(prepared()))
        del prepared
        figures[method] = {
            "cpu_s": cpu_s,
            "again_cpu_s": again_cpu_s,
            "peak_bytes": _peaks(first, min(runs, _MEMORY_RUNS)),
        }
    np.save(made, np.stack(results))
    print(json.dumps(figures))


if __name__ == "__main__":
    run_methods(sys.argv[1:])
