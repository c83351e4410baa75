"""Multigrid-preconditioned conjugate gradients for graph Laplacians on the pixel grid.

The solver is matrix-free: a level consists of two arrays of edge weights. A pixel of a coarse level
aggregates 2 x 2 pixels (plain aggregation). The edge weights are summed and halved, which
compensates for the stiffness of piecewise constant corrections (Braess, 1995). Weights of pixels,
which hold them at given values, are summed without halving. The cycle uses float32 and red-black
Gauss-Seidel smoothing, the conjugate gradients use float64.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import eigvalsh_tridiagonal

import processing.surface.multigrid_kernels as kernels
from processing.surface.grid_graph import apply_laplacian
from processing.surface.thin_graphs import is_thin, solve_thin
from rig import Progress, no_progress
from rig.arrays import Float32, Float64

# Number of smoothing sweeps before and after the coarse correction.
_SWEEPS = 2
# Below this number of pixels, starting threads costs more time than it saves.
_SERIAL_PIXELS = 1 << 14
# Below this relative residual, rounding errors would grow with every iteration.
_ROUNDING = 1e-14
# After this number of iterations, graphs on thin masks are solved by elimination.
_PATIENCE = 30
# Maximum size of the coarsest grid, which is solved exactly by its pseudo-inverse.
_COARSEST_PIXELS = 16


@dataclass(frozen=True, eq=False)
class Solution:
    """The solution of a linear system with a graph Laplacian.

    Parameters
    ----------
    u
        ``(H+2, W+2)`` float64, determined up to a constant on each connected part.
    iterations
        Number of iterations of the conjugate gradients.
    relative_residual
        2-norm of b - L u divided by the 2-norm of b.
    converged
        Whether the residual is within the tolerance, or the error within the accuracy.
    """

    u: Float64
    iterations: int
    relative_residual: float
    converged: bool


def solve(
    right: Float32,
    down: Float32,
    b: Float64,
    *,
    anchors: Float32 | None = None,
    levels: Levels | None = None,
    tolerance: float = 1e-6,
    accuracy: float = 0.0,
    max_iterations: int = 500,
    on_progress: Progress = no_progress,
) -> Solution:
    """Solve (L + A) u = b for the graph Laplacian L of a weighted pixel grid.

    Without anchors, L is singular: its null space consists of the constants on each connected part.
    L is not regularised. b must sum to 0 over each part; then every residual does, too. The caller
    chooses the constants. Anchors A determine the constants of their parts.

    Parameters
    ----------
    right, down
        ``(H+2, W+2)`` float32 edge weights with an empty border, 0 or more, as in
        `processing.surface.grid_graph`.
    b
        ``(H+2, W+2)`` right-hand side, 0 on pixels without edges.
    anchors
        ``(H+2, W+2)`` float32 diagonal of A: weights of pixels, 0 or more, and 0 on pixels without
        edges; default: none.
    levels
        The `coarsened` weights, if several systems have the same ones.
    tolerance
        Relative residual at which the iteration stops; values below 1e-14 mean 1e-14.
    accuracy
        Estimated largest error at which the iteration stops, too; 0 for none.
    max_iterations
        Maximum number of iterations.
    on_progress
        Receives the stage ``integrating``: digits of the residual, in percent.

    Returns
    -------
    Solution
        The solution, with its residual.
    """
    u = np.zeros_like(b)
    norm_b = math.sqrt(np.vdot(b, b))
    if norm_b == 0:
        return Solution(u, 0, 0.0, converged=True)
    # The cycle uses float32: scale the right-hand side to its range.
    scale = float(np.abs(b).max())
    levels = coarsened(right, down, anchors) if levels is None else levels
    residual = b / scale
    # Not needed any longer: of callers that do not hold it either, it is freed.
    del b
    target = max(tolerance, _ROUNDING) * norm_b / scale
    direction, product = np.zeros_like(u), np.zeros_like(u)

    def multiplied(values: Float64) -> float:
        """Write (L + A) v to the product, and return its scalar product with v."""
        curvature = float(apply_laplacian(right, down, values, product).sum())
        if anchors is not None:
            curvature += float(kernels.add_anchors(anchors, values, product).sum())
        return curvature

    gamma, norm_r, iteration = 0.0, norm_b / scale, 0
    digits = math.log(norm_r / target) if norm_r > target else 1.0
    percent = 0
    on_progress("integrating", percent, 100)
    accurate, lanczos = False, _Lanczos()
    while norm_r > target and not accurate and iteration < max_iterations:
        correction = _cycle(levels, residual)
        gamma, previous = float(kernels.dot(residual, correction).sum()), gamma
        kernels.add_scaled(direction, correction, gamma / previous if iteration else 0.0)
        curvature = multiplied(direction)
        if not curvature > 0:  # the residual consists of rounding errors
            break
        norm_r = math.sqrt(kernels.step(u, residual, direction, product, gamma / curvature).sum())
        iteration += 1
        if accuracy:
            lanczos.add(gamma / curvature, gamma / previous if previous else 0.0)
            largest = max(float(correction.max()), -float(correction.min())) * scale
            # Squared, because the slowest errors are found late.
            accurate = largest <= accuracy and largest <= accuracy * lanczos.smallest() ** 2
        left = max(math.log(max(norm_r, target) / target), 0.0)
        percent = max(percent, round(100 * (1 - left / digits)))
        on_progress("integrating", percent, 100)
        if iteration == _PATIENCE and norm_r > target and is_thin(right, down):
            rest = solve_thin(right, down, residual, anchors)
            multiplied(rest)
            left_over = float(np.linalg.norm(residual - product)) * scale / norm_b
            u += rest
            u *= scale
            on_progress("integrating", 100, 100)
            return Solution(u, iteration, left_over, converged=left_over <= tolerance)
    u *= scale
    return Solution(u, iteration, norm_r * scale / norm_b, converged=accurate or norm_r <= target)


class _Lanczos:
    """The matrix of Lanczos (1950) that conjugate gradients build: M L in the space they searched.

    The smallest eigenvalue is the share of an error that a correction by M removes at least.
    """

    def __init__(self) -> None:
        self._diagonal: list[float] = []
        self._beside: list[float] = []
        self._step = 1.0

    def add(self, step: float, repeated: float) -> None:
        """Add an iteration: the length of its step, and the share of the earlier direction."""
        if self._diagonal:
            self._beside.append(math.sqrt(repeated) / self._step)
        self._diagonal.append(1 / step + repeated / self._step)
        self._step = step

    def smallest(self) -> float:
        """Return the smallest eigenvalue."""
        found = eigvalsh_tridiagonal(self._diagonal, self._beside, select="i", select_range=(0, 0))
        return float(found[0])


# Kernels that begin, smooth, restrict and prolong.
_Loops = tuple[Callable[..., None], ...]
_PARALLEL: _Loops = (kernels.begin, kernels.smooth, kernels.restrict, kernels.prolong)
_SERIAL: _Loops = (
    kernels.begin_serial,
    kernels.smooth_serial,
    kernels.restrict_serial,
    kernels.prolong_serial,
)


@dataclass(frozen=True, eq=False)
class _Level:
    """One grid: weights, inverse diagonal, and buffers for unknowns and right-hand side."""

    right: Float32
    down: Float32
    anchors: Float32 | None
    inverse: Float32
    x: Float32
    b: Float32
    loops: _Loops
    # Pseudo-inverse of the Laplacian on the inner pixels; only on the coarsest level.
    dense: Float32 | None


Levels = list[_Level]


def coarsened(right: Float32, down: Float32, anchors: Float32 | None = None) -> Levels:
    """Return the levels of the multigrid for weights, as for `solve`."""
    levels: Levels = []
    while True:
        inner = (right.shape[0] - 2) * (right.shape[1] - 2)
        last = inner <= _COARSEST_PIXELS
        levels.append(
            _Level(
                right,
                down,
                anchors,
                _inverse(diagonal_of(right, down, anchors)),
                np.zeros_like(right),
                np.zeros_like(right),
                _SERIAL if inner < _SERIAL_PIXELS else _PARALLEL,
                _pseudo_inverse(right, down, anchors) if last else None,
            )
        )
        if last:
            return levels
        right, down = kernels.aggregate(right, down)
        if anchors is not None:
            anchors = _sums_of_blocks(anchors, right.shape)


def _cycle(levels: list[_Level], residual: Float64) -> Float32:
    """Return the correction of one V-cycle for a residual; the operator is symmetric positive."""
    levels[0].b[...] = residual
    for fine, coarse in pairwise(levels):
        begin, smooth, restrict, _ = fine.loops
        begin(fine.inverse, fine.b, fine.x)
        for colour in ((0, 1) * _SWEEPS)[1:]:
            smooth(fine.right, fine.down, fine.inverse, fine.b, fine.x, colour)
        restrict(fine.right, fine.down, fine.b, fine.x, coarse.b)
        if fine.anchors is not None:
            held = fine.anchors * fine.x
            # Pixels of colour 1 have no residual.
            held[::2, ::2] = held[1::2, 1::2] = 0
            coarse.b[...] -= _sums_of_blocks(held, coarse.b.shape)
    last = levels[-1]
    if last.dense is not None:
        inner = last.b[1:-1, 1:-1]
        last.x[1:-1, 1:-1] = (last.dense @ inner.ravel()).reshape(inner.shape)
    for fine, coarse in zip(levels[-2::-1], levels[:0:-1], strict=True):
        _, smooth, _, prolong = fine.loops
        prolong(coarse.x, fine.inverse, fine.x)
        # The reverse order of colours makes the cycle symmetric, which conjugate gradients require.
        for colour in (1, 0) * _SWEEPS:
            smooth(fine.right, fine.down, fine.inverse, fine.b, fine.x, colour)
    return levels[0].x


def _sums_of_blocks(values: Float32, shape: tuple[int, ...]) -> Float32:
    """Return the sums over the 2 x 2 pixels of each coarse pixel, with an empty border."""
    rows, columns = shape[0] - 2, shape[1] - 2
    # An odd last row or column is paired with the empty border.
    inner = values[1 : 1 + 2 * rows, 1 : 1 + 2 * columns]
    sums = np.zeros(shape, np.float32)
    sums[1:-1, 1:-1] = inner[::2, ::2] + inner[1::2, ::2] + inner[::2, 1::2] + inner[1::2, 1::2]
    return sums


def _pseudo_inverse(right: Float32, down: Float32, anchors: Float32 | None) -> Float32:
    rows, columns = right.shape[0] - 2, right.shape[1] - 2
    node = np.arange(rows * columns).reshape(rows, columns)
    matrix = np.zeros((rows * columns, rows * columns))
    for weight, a, b in (
        (right[1:-1, 1:-2], node[:, :-1], node[:, 1:]),
        (down[1:-2, 1:-1], node[:-1], node[1:]),
    ):
        matrix[a, b] -= weight
        matrix[b, a] -= weight
    diagonal = -matrix.sum(axis=1)
    if anchors is not None:
        diagonal += anchors[1:-1, 1:-1].ravel()
    np.fill_diagonal(matrix, diagonal)
    inverse = np.linalg.pinv(matrix, rcond=1e-10, hermitian=True)
    # Pixels without edges remain exactly 0.
    inverse[diagonal == 0] = 0
    return np.asarray(inverse, np.float32)


def _inverse(diagonal: Float32) -> Float32:
    inverse: Float32 = np.divide(1, diagonal, out=np.zeros_like(diagonal), where=diagonal > 0)
    return inverse


def diagonal_of(right: Float32, down: Float32, anchors: Float32 | None) -> Float32:
    """Return the diagonal of L + A."""
    diagonal = right + down
    if anchors is not None:
        diagonal += anchors
    diagonal[:, 1:] += right[:, :-1]
    diagonal[1:] += down[:-1]
    return diagonal
