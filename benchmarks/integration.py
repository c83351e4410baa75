"""Surface from normals: compare multigrid-preconditioned CG with other solvers.

Each row is a mask with a wavy surface with 1 degree of noise on its normals, solved to a relative
residual of 1e-6 with compiled kernels, in a process of its own. The mask is a disc with a hole, the
whole rectangle, or a ragged region with many holes. scipy's solvers and pyamg (Ruge-Stueben
multigrid and CG) get the finished matrix, ours gets the edges from which it is built; "integrate,
whole" is the complete call on a normal map. pyamg is left out unless it is installed (``pip install
pyamg``). CPU seconds are those of all threads. "bytes/px" is the growth of the peak of resident
memory per pixel of the bounding box (on Linux). The last two columns are CPU seconds and memory
relative to multigrid CG.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Any, Literal

import cv2
import numpy as np
from harness import Cost, alone, command_line, measured
from scipy import sparse
from scipy.sparse import linalg

from processing import NormalMap, integrate
from processing.surface.chord_rule import orthographic_edges
from processing.surface.grid_graph import divergence
from processing.surface.multigrid import solve
from rig.arrays import Bool, Float32, Float64

Graph = tuple[Float32, Float32, Float64]
System = tuple[sparse.csc_array, Float64]


Shape = Literal["disc", "rectangle", "ragged"]


def mask_of(shape: Shape, pixels: int) -> Bool:
    """Return a square image with about ``pixels`` pixels inside."""
    share = {"disc": 0.9 * np.pi / 4 - 0.005 * np.pi, "rectangle": 1.0, "ragged": 0.684}[shape]
    n = round(np.sqrt(pixels / share))
    y, x = np.mgrid[1 : -1 : n * 1j, -1 : 1 : n * 1j].astype(np.float32)
    if shape == "rectangle":
        return np.ones((n, n), bool)
    if shape == "disc":
        return (x**2 + y**2 < 0.9) & ((x - 0.2) ** 2 + (y - 0.3) ** 2 > 0.02)
    rng = np.random.default_rng(0)
    rough = cv2.resize(rng.normal(size=(64, 64)), (n, n), interpolation=cv2.INTER_CUBIC)
    holes = rng.random((n, n)) < 0.01
    inside = (x**2 + y**2 < 1) & (rough < 1.2) & ~holes
    _, labels = cv2.connectedComponents(inside.astype(np.uint8), connectivity=4)
    largest: Bool = labels == np.argmax(np.bincount(labels[inside]))
    return largest


def normal_map(shape: Shape, pixels: int) -> NormalMap:
    mask = mask_of(shape, pixels)
    n = len(mask)
    y, x = np.mgrid[1 : -1 : n * 1j, -1 : 1 : n * 1j].astype(np.float32)
    noise = np.random.default_rng(0).normal(scale=np.radians(1), size=(n, n, 3))
    slopes = [-0.9 * np.cos(3 * x) * np.cos(2 * y), 0.6 * np.sin(3 * x) * np.sin(2 * y)]
    return NormalMap.from_vectors(np.stack([*slopes, np.ones_like(x)], axis=2) + noise, mask)


def problem(shape: Shape, pixels: int) -> Graph:
    normals = normal_map(shape, pixels)
    right, down, step_right, step_down = orthographic_edges(normals.normals, normals.mask)
    return right, down, divergence(right, down, step_right, step_down)


def as_matrix(shape: Shape, pixels: int) -> System:
    """Return the Laplacian on the mask; the first pixel is fixed at 0, so that it is regular."""
    right, down, b = problem(shape, pixels)
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


def ruge_stueben(system: System) -> int:
    import pyamg

    matrix, b = system
    residuals: list[float] = []
    hierarchy = pyamg.ruge_stuben_solver(sparse.csr_matrix(matrix))
    hierarchy.solve(b, tol=1e-6, accel="cg", maxiter=200, residuals=residuals)
    return len(residuals) - 1


def whole(normals: NormalMap) -> int:
    return integrate(normals).iterations


OURS = "multigrid CG"
# For each solver: the function that builds its input, and the function that solves it.
SOLVERS: dict[str, tuple[Callable[[Shape, int], Any], Callable[[Any], int]]] = {
    OURS: (problem, ours),
    "integrate, whole": (normal_map, whole),
    "pyamg RS + CG": (as_matrix, ruge_stueben),
    "scipy splu": (as_matrix, direct),
    "scipy CG + Jacobi": (as_matrix, jacobi),
}


def measure(name: str, shape: Shape, pixels: int) -> tuple[Cost, int]:
    make, solved = SOLVERS[name]
    solved(make(shape, 20_000))  # compiles
    system = make(shape, pixels)
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
    parser.add_argument(
        "--shape", choices=["disc", "rectangle", "ragged"], default="disc", help="shape of the mask"
    )
    options = parser.parse_args()
    if importlib.util.find_spec("pyamg") is None:
        print("pyamg is not installed, and left out: pip install pyamg")
        del SOLVERS["pyamg RS + CG"]
    print(
        f"{'solver':18} {'pixels':>9} {'CPU s':>8} {'wall s':>8} {'iterations':>10} "
        f"{'bytes/px':>9} {'x CPU':>6} {'x memory':>8}"
    )
    for pixels in options.pixels:
        area = mask_of(options.shape, pixels).size
        costs: dict[str, Cost] = {}
        for name in SOLVERS:
            if name.startswith("scipy") and pixels > options.scipy_limit:
                continue
            cost, iterations = alone(measure, name, options.shape, pixels)
            costs[name] = cost
            print(
                f"{name:18} {pixels:9,d} {cost.cpu_s:8.2f} {cost.wall_s:8.2f} {iterations:10d} "
                f"{cost.peak_bytes / area:9.0f} {cost.cpu_s / costs[OURS].cpu_s:6.1f} "
                f"{cost.peak_bytes / costs[OURS].peak_bytes:8.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
