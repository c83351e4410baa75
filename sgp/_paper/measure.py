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
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from processing import NormalMap, ShapeFilter, combine, height_mesh, integrate, separate
from rig import module_command
from sgp._paper.displacement import transfer_by_displacement
from sgp._paper.laplacian import transfer_by_laplacian
from sgp._paper.mesh import Vectors, vertex_normals

Method = Literal["DSPL", "LAPL", "normals", "normals, order 8"]
METHODS: tuple[Method, ...] = ("DSPL", "LAPL", "normals", "normals, order 8")
Mask = npt.NDArray[np.bool_]

_PEERS = {"DSPL": transfer_by_displacement, "LAPL": transfer_by_laplacian}


@dataclass(frozen=True, eq=False)
class Measured:
    """A transfer's result and what it took.

    Parameters
    ----------
    normal_map
        The result.
    cpu_s, wall_s
        Of each run; CPU seconds are of all threads.
    peak_bytes
        Resident memory at its peak above what was there with the inputs loaded; None where the
        system does not tell.
    """

    normal_map: NormalMap
    cpu_s: tuple[float, ...]
    wall_s: tuple[float, ...]
    peak_bytes: int | None


def measure(
    methods: Sequence[Method],
    source: NormalMap,
    target: NormalMap,
    *,
    region: Mask | None = None,
    w: int = 5,
    runs: int = 1,
) -> dict[Method, Measured]:
    """Transfer detail by some methods in a new process, one after the other, with warm caches.

    The mesh methods are given the surfaces that the normal maps integrate to, pixel on pixel; how
    long that integration takes does not count. "normals" is separation by the paper's filter and
    its transfer.

    Parameters
    ----------
    methods
        Of `METHODS`.
    source, target
        Maps of one size, the source laid over the target.
    region
        ``(H, W)`` bool, for the mesh methods: the part that receives detail. Default: all.
    w
        Half width of the paper's filter.
    runs
        How often.
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
        call = module_command(__name__, given, made, w, runs, *methods)
        # Idle threads sleep, as in `sgp`, else their spinning would count as work.
        environment = os.environ | {"OMP_WAIT_POLICY": "passive"}
        done = subprocess.run(call, check=True, env=environment, stdout=subprocess.PIPE, text=True)
        figures = json.loads(done.stdout)
        results = np.load(made)
    return {
        method: Measured(
            NormalMap(normals, mask),
            tuple(figures[method]["cpu_s"]),
            tuple(figures[method]["wall_s"]),
            figures[method]["peak_bytes"],
        )
        for method, normals in zip(methods, results, strict=True)
    }


class _Bench:
    """The inputs of every method, made ready; what is left to `run` is what is measured."""

    def __init__(self, source: NormalMap, target: NormalMap, region: Mask | None, w: int) -> None:
        self._source, self._target, self._w = source, target, w
        from_surface, to_surface = integrate(source), integrate(target)
        mesh = height_mesh(to_surface)
        inside = to_surface.mask
        self._to = mesh.vertices.astype(np.float64)
        self._from = from_surface.points()[inside].astype(np.float64)
        # A pixel that stands alone in one of the surfaces has no height: no triangle touches it.
        known = from_surface.mask[inside]
        self._from[~known] = self._to[~known]
        self._faces = mesh.faces[known[mesh.faces].all(axis=1)]
        self._region = None if region is None else region[inside]
        self._meshed = np.zeros(len(self._to), np.bool_)
        self._meshed[self._faces] = True
        self._pixels = np.flatnonzero(inside)[self._meshed]

    def run(self, method: str) -> NormalMap | Vectors:
        if method in _PEERS:
            return _PEERS[method](self._from, self._to, self._faces, self._region, self._w)
        order = 8 if method.endswith("order 8") else 1
        shape = ShapeFilter("gaussian", order, self._w).shape(self._target)
        return combine(shape, separate(self._source, order=order, w=self._w).detail)

    def normals(self, result: NormalMap | Vectors) -> npt.NDArray[np.float32]:
        if isinstance(result, NormalMap):
            return result.normals
        normals = self._target.normals.copy()
        found = vertex_normals(result, self._faces)[self._meshed]
        normals.reshape(-1, 3)[self._pixels] = found
        return normals


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


def _measured(bench: _Bench, method: str, runs: int) -> tuple[dict[str, Any], NormalMap | Vectors]:
    cpu_s: list[float] = []
    wall_s: list[float] = []
    for _ in range(runs):
        cpu, wall = time.process_time(), time.perf_counter()
        result = bench.run(method)
        cpu_s.append(time.process_time() - cpu)
        wall_s.append(time.perf_counter() - wall)
    # Memory in a run of its own: taking pages from the system anew costs time.
    before = _peak_begins()
    result = bench.run(method)
    peak = None if before is None else _resident_bytes("VmHWM") - before
    return {"cpu_s": cpu_s, "wall_s": wall_s, "peak_bytes": peak}, result


def _main(given: str, made: str, w: str, runs: str, *methods: str) -> None:
    with np.load(given) as arrays:
        mask = arrays["mask"]
        source, target = (
            NormalMap(np.where(mask[..., None], arrays[name], 0), mask)
            for name in ("source", "target")
        )
        region = None if arrays["whole"] else arrays["region"]
    flat = NormalMap(np.tile(np.array([0, 0, 1], np.float32), (40, 40, 1)), np.ones((40, 40), bool))
    warm, bench = _Bench(flat, flat, None, int(w)), _Bench(source, target, region, int(w))
    figures, results = {}, []
    for method in methods:
        warm.run(method)
        figures[method], result = _measured(bench, method, int(runs))
        results.append(bench.normals(result))
    np.save(made, np.stack(results))
    print(json.dumps(figures))


if __name__ == "__main__":
    _main(*sys.argv[1:])
