"""Surface from normals: multigrid-preconditioned CG beside scipy's solvers on the same problem.

python benchmarks/integration.py [--pixels 119000 475000 1900000] [--scipy-limit 500000]

Each row is a disc with a hole, a wavy surface with 1 degree of noise on its normals, solved to a
relative residual of 1e-6 with warm caches, in a process of its own. CPU seconds are of all its
threads. "bytes/px" is the peak of the resident memory above what was there before, per pixel of the
bounding box (on Linux).
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse import linalg

from processing._normal_map import NormalMap
from processing._surface.chord_rule import orthographic_edges
from processing._surface.grid_graph import divergence
from processing._surface.integration import integrate
from processing._surface.multigrid import solve

RESET_PEAK = Path("/proc/self/clear_refs")

Graph = tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.float64]]


def normal_map(pixels: int) -> NormalMap:
    n = round(np.sqrt(pixels / (0.9 * np.pi / 4 - 0.005 * np.pi)))
    y, x = np.mgrid[1 : -1 : n * 1j, -1 : 1 : n * 1j].astype(np.float32)
    mask = (x**2 + y**2 < 0.9) & ((x - 0.2) ** 2 + (y - 0.3) ** 2 > 0.02)
    noise = np.random.default_rng(0).normal(scale=np.radians(1), size=(n, n, 3))
    slopes = [-0.9 * np.cos(3 * x) * np.cos(2 * y), 0.6 * np.sin(3 * x) * np.sin(2 * y)]
    return NormalMap.from_vectors(np.stack([*slopes, np.ones_like(x)], axis=2) + noise, mask)


def problem(pixels: int) -> Graph:
    given = normal_map(pixels)
    right, down, step_right, step_down = orthographic_edges(given.normals, given.mask)
    return right, down, divergence(right, down, step_right, step_down)


def as_matrix(graph: Graph) -> tuple[sparse.csc_array, npt.NDArray[np.float64]]:
    """The Laplacian on the mask's pixels; the first is held at 0, which makes it regular."""
    right, down, b = graph
    linked = right + np.roll(right, 1, 1) + down + np.roll(down, 1, 0) > 0
    number = np.full(right.shape, -1)
    number[linked] = np.arange(linked.sum())
    i = np.concatenate([number[:, :-1][right[:, :-1] > 0], number[:-1][down[:-1] > 0]])
    j = np.concatenate([number[:, 1:][right[:, :-1] > 0], number[1:][down[:-1] > 0]])
    w = np.concatenate([right[right > 0], down[down > 0]]).astype(np.float64)
    size = int(linked.sum())
    adjacency = sparse.coo_array((w, (i, j)), (size, size))
    adjacency = adjacency + adjacency.T
    laplacian = sparse.csc_array(sparse.diags_array(adjacency.sum(axis=0)) - adjacency)
    return laplacian[1:, 1:], b[linked][1:]


def ours(graph: Graph) -> int:
    return solve(*graph).iterations


def direct(graph: Graph) -> int:
    matrix, b = as_matrix(graph)
    linalg.spsolve(matrix, b, permc_spec="MMD_AT_PLUS_A")
    return 1


def jacobi(graph: Graph) -> int:
    matrix, b = as_matrix(graph)
    steps = [0]

    def count(_: object) -> None:
        steps[0] += 1

    preconditioner = sparse.diags_array(1 / matrix.diagonal())
    linalg.cg(matrix, b, rtol=1e-6, maxiter=20000, M=preconditioner, callback=count)
    return steps[0]


def whole(pixels: int) -> int:
    return integrate(normal_map(pixels)).iterations


SOLVERS: dict[str, Callable[[Graph], int]] = {
    "multigrid CG": ours,
    "scipy spsolve": direct,
    "scipy CG + Jacobi": jacobi,
}


def resident_bytes(entry: str) -> int:
    status = Path("/proc/self/status").read_text()
    line = next(line for line in status.splitlines() if line.startswith(entry))
    return int(line.split()[1]) * 1024


def measure(name: str, pixels: int) -> str:
    SOLVERS[name](problem(2000))
    graph = problem(pixels)
    before = resident_bytes("VmRSS")
    RESET_PEAK.write_text("5")
    cpu, wall = time.process_time(), time.perf_counter()
    iterations = SOLVERS[name](graph)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    peak = (resident_bytes("VmHWM") - before) / graph[0].size
    return f"{name:18} {pixels:9,d} {cpu:8.2f} {wall:8.2f} {iterations:10d} {peak:9.0f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pixels", type=int, nargs="+", default=[119_000, 475_000, 1_900_000])
    parser.add_argument("--scipy-limit", type=int, default=200_000)
    parser.add_argument("--solver", choices=list(SOLVERS), help="this one alone, in this process")
    options = parser.parse_args()
    if options.solver:
        for pixels in options.pixels:
            print(measure(options.solver, pixels), flush=True)
        return
    print(
        f"{'solver':18} {'pixels':>9} {'CPU s':>8} {'wall s':>8} {'iterations':>10} {'bytes/px':>9}"
    )
    for pixels in options.pixels:
        for name in SOLVERS:
            if name != "multigrid CG" and pixels > options.scipy_limit:
                continue
            call = [sys.executable, __file__, "--solver", name, "--pixels", str(pixels)]
            # Freed blocks go back to the system at once, else they would hide what is used.
            subprocess.run(call, check=True, env=os.environ | {"MALLOC_MMAP_THRESHOLD_": "65536"})
    whole(2000)
    for pixels in options.pixels:
        given = normal_map(pixels)
        cpu = time.process_time()
        integrate(given)
        print(f"{'integrate, whole':18} {pixels:9,d} {time.process_time() - cpu:8.2f}")


if __name__ == "__main__":
    main()
