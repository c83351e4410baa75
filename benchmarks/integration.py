"""Surface from normals: compare multigrid-preconditioned CG with scipy's solvers.

Each row is a disc with a hole and a wavy surface with 1 degree of noise on its normals, solved to a
relative residual of 1e-6 with warm caches, in a process of its own. scipy's solvers get the
finished matrix, multigrid gets the edges from which it is built; "integrate, whole" is the complete
call on a normal map. CPU seconds are those of all threads. "bytes/px" is the growth of the peak of
resident memory per pixel of the bounding box (on Linux). The last two columns are CPU seconds and
memory relative to multigrid CG.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from harness import Cost, alone, command_line, measured
from scipy import sparse
from scipy.sparse import linalg

from processing._normal_map import NormalMap
from processing._surface.chord_rule import orthographic_edges
from processing._surface.grid_graph import divergence
from processing._surface.integration import integrate
from processing._surface.multigrid import solve

Graph = tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.float64]]
System = tuple[sparse.csc_array, npt.NDArray[np.float64]]


def side(pixels: int) -> int:
    """Return the side of the bounding box of a mask with ``pixels`` pixels."""
    return round(np.sqrt(pixels / (0.9 * np.pi / 4 - 0.005 * np.pi)))


def normal_map(pixels: int) -> NormalMap:
    n = side(pixels)
    y, x = np.mgrid[1 : -1 : n * 1j, -1 : 1 : n * 1j].astype(np.float32)
    mask = (x**2 + y**2 < 0.9) & ((x - 0.2) ** 2 + (y - 0.3) ** 2 > 0.02)
    noise = np.random.default_rng(0).normal(scale=np.radians(1), size=(n, n, 3))
    slopes = [-0.9 * np.cos(3 * x) * np.cos(2 * y), 0.6 * np.sin(3 * x) * np.sin(2 * y)]
    return NormalMap.from_vectors(np.stack([*slopes, np.ones_like(x)], axis=2) + noise, mask)


def problem(pixels: int) -> Graph:
    normals = normal_map(pixels)
    right, down, step_right, step_down = orthographic_edges(normals.normals, normals.mask)
    return right, down, divergence(right, down, step_right, step_down)


def as_matrix(pixels: int) -> System:
    """Return the Laplacian on the mask; the first pixel is fixed at 0, so that it is regular."""
    right, down, b = problem(pixels)
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


def direct(system: System) -> int:
    matrix, b = system
    symmetric = {"SymmetricMode": True}
    factors = linalg.splu(matrix, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)
    factors.solve(b)
    return 1


def jacobi(system: System) -> int:
    matrix, b = system
    steps = [0]

    def count(_: object) -> None:
        steps[0] += 1

    preconditioner = sparse.diags_array(1 / matrix.diagonal())
    linalg.cg(matrix, b, rtol=1e-6, maxiter=20000, M=preconditioner, callback=count)
    return steps[0]


def whole(normals: NormalMap) -> int:
    return integrate(normals).iterations


OURS = "multigrid CG"
# For each solver: the function that builds its input, and the function that solves it.
SOLVERS: dict[str, tuple[Callable[[int], Any], Callable[[Any], int]]] = {
    OURS: (problem, ours),
    "integrate, whole": (normal_map, whole),
    "scipy splu": (as_matrix, direct),
    "scipy CG + Jacobi": (as_matrix, jacobi),
}


def measure(name: str, pixels: int) -> tuple[Cost, int]:
    make, solved = SOLVERS[name]
    system = make(pixels)
    solved(system)  # compiles, fills caches
    return measured(lambda: solved(system))


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument(
        "--pixels",
        type=int,
        nargs="+",
        default=[119_000, 475_000, 1_900_000],
        help="pixels in the mask",
    )
    parser.add_argument(
        "--scipy-limit", type=int, default=200_000, help="most pixels for scipy's solvers"
    )
    options = parser.parse_args()
    print(
        f"{'solver':18} {'pixels':>9} {'CPU s':>8} {'wall s':>8} {'iterations':>10} "
        f"{'bytes/px':>9} {'x CPU':>6} {'x memory':>8}"
    )
    for pixels in options.pixels:
        costs: dict[str, Cost] = {}
        for name in SOLVERS:
            if name.startswith("scipy") and pixels > options.scipy_limit:
                continue
            cost, iterations = alone(measure, name, pixels)
            costs[name] = cost
            print(
                f"{name:18} {pixels:9,d} {cost.cpu_s:8.2f} {cost.wall_s:8.2f} {iterations:10d} "
                f"{cost.peak_bytes / side(pixels) ** 2:9.0f} {cost.cpu_s / costs[OURS].cpu_s:6.1f} "
                f"{cost.peak_bytes / costs[OURS].peak_bytes:8.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
