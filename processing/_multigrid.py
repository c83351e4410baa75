"""Graph Laplacians on the pixel grid solved by multigrid-preconditioned conjugate gradients.

Matrix-free: a level is two arrays of edge weights. Coarse levels gather 2 x 2 pixels into one
(plain aggregation; edge weights add up and are halved, which makes up for the stiffness of
piecewise constant corrections, Braess 1995). The cycle runs in float32 with red-black Gauss-Seidel,
the conjugate gradients around it in float64.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numba
import numpy as np
import numpy.typing as npt

from processing._grid_graph import apply_laplacian

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]

# Smoothing sweeps before and after the coarse correction.
_SWEEPS = 2
# Below this many pixels threads cost more than they bring.
_SERIAL_PIXELS = 1 << 14
# The coarsest grid, solved exactly by its pseudo-inverse.
_COARSEST_PIXELS = 100


@dataclass(frozen=True, eq=False)
class Solution:
    """A solved graph Laplacian.

    Parameters
    ----------
    u
        ``(H+2, W+2)`` float64, free up to a constant on each connected part.
    iterations
        Of the conjugate gradients.
    relative_residual
        2-norm of b - L u over that of b.
    converged
        Whether that met the tolerance.
    """

    u: Double
    iterations: int
    relative_residual: float
    converged: bool


def solve(
    right: Float, down: Float, b: Double, *, tolerance: float = 1e-6, max_iterations: int = 500
) -> Solution:
    """Solve L u = b for the graph Laplacian L of a weighted pixel grid.

    L is singular, constants on each connected part are its null space. Nothing is added to its
    diagonal: b must sum to 0 over each part, then so does every residual, and the free constants
    are left to the caller.

    Parameters
    ----------
    right, down
        ``(H+2, W+2)`` float32 edge weights with an empty border, 0 or more, as in
        `processing._grid_graph`.
    b
        ``(H+2, W+2)`` right-hand side, 0 on pixels without edges.
    tolerance
        Relative residual to stop at.
    max_iterations
        Where to give up.

    Returns
    -------
    Solution
        With the residual reached.
    """
    u = np.zeros_like(b)
    norm_b = math.sqrt(np.vdot(b, b))
    if norm_b == 0:
        return Solution(u, 0, 0.0, converged=True)
    # The cycle computes in float32: a right-hand side of any scale must fit it.
    scale = float(np.abs(b).max())
    levels = _coarsen(right, down)
    residual = b / scale
    target = tolerance * norm_b / scale
    direction, product = np.zeros_like(b), np.zeros_like(b)
    gamma, norm_r, iteration = 0.0, norm_b / scale, 0
    while norm_r > target and iteration < max_iterations:
        correction = _cycle(levels, residual)
        gamma, previous = float(_dot(residual, correction).sum()), gamma
        _add_scaled(direction, correction, gamma / previous if iteration else 0.0)
        curvature = float(apply_laplacian(right, down, direction, product).sum())
        if not curvature > 0:  # only rounding is left of the residual
            break
        norm_r = math.sqrt(_step(u, residual, direction, product, gamma / curvature).sum())
        iteration += 1
    u *= scale
    return Solution(u, iteration, norm_r * scale / norm_b, converged=norm_r <= target)


@dataclass(frozen=True, eq=False)
class _Level:
    """One grid: edge weights, inverse diagonal, and room for the cycle's unknown and right side."""

    right: Float
    down: Float
    inverse: Float
    x: Float
    b: Float
    serial: bool
    # Pseudo-inverse of the coarsest level's Laplacian, in its inner pixels.
    dense: Float | None


def _coarsen(right: Float, down: Float) -> list[_Level]:
    levels: list[_Level] = []
    while True:
        inner = (right.shape[0] - 2) * (right.shape[1] - 2)
        last = inner <= _COARSEST_PIXELS
        levels.append(
            _Level(
                right,
                down,
                _inverse_diagonal(right, down),
                np.zeros_like(right),
                np.zeros_like(right),
                inner < _SERIAL_PIXELS,
                _pseudo_inverse(right, down) if last else None,
            )
        )
        if last:
            return levels
        right, down = _aggregate(right, down)


def _cycle(levels: list[_Level], residual: Double) -> Float:
    """Return one V-cycle's correction for a residual: a symmetric positive operator."""
    levels[0].b[...] = residual
    for fine, coarse in pairwise(levels):
        smooth, restrict = (
            (_smooth_serial, _restrict_serial) if fine.serial else (_smooth, _restrict)
        )
        fine.x[...] = 0
        for colour in (0, 1) * _SWEEPS:
            smooth(fine.right, fine.down, fine.inverse, fine.b, fine.x, colour)
        restrict(fine.right, fine.down, fine.b, fine.x, coarse.b)
    last = levels[-1]
    if last.dense is not None:
        inner = last.b[1:-1, 1:-1]
        last.x[1:-1, 1:-1] = (last.dense @ inner.ravel()).reshape(inner.shape)
    for fine, coarse in zip(levels[-2::-1], levels[:0:-1], strict=True):
        smooth, prolong = (_smooth_serial, _prolong_serial) if fine.serial else (_smooth, _prolong)
        prolong(coarse.x, fine.inverse, fine.x)
        # The colours in reverse order make the cycle symmetric, as conjugate gradients need it.
        for colour in (1, 0) * _SWEEPS:
            smooth(fine.right, fine.down, fine.inverse, fine.b, fine.x, colour)
    return levels[0].x


def _pseudo_inverse(right: Float, down: Float) -> Float:
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
    np.fill_diagonal(matrix, diagonal)
    inverse = np.linalg.pinv(matrix, rcond=1e-10, hermitian=True)
    # Pixels without edges stay exactly 0.
    inverse[diagonal == 0] = 0
    return np.asarray(inverse, np.float32)


def _inverse_diagonal(right: Float, down: Float) -> Float:
    diagonal = right + down
    diagonal[:, 1:] += right[:, :-1]
    diagonal[1:] += down[:-1]
    inverse: Float = np.divide(1, diagonal, out=np.zeros_like(diagonal), where=diagonal > 0)
    return inverse


@numba.njit(cache=True)
def _aggregate(right: Float, down: Float) -> tuple[Float, Float]:
    rows, columns = (right.shape[0] - 1) // 2, (right.shape[1] - 1) // 2
    coarse_right = np.zeros((rows + 2, columns + 2), np.float32)
    coarse_down = np.zeros((rows + 2, columns + 2), np.float32)
    half = np.float32(0.5)
    # Coarse pixel R holds the fine rows 2R-1 and 2R; an odd last row has the empty border as mate.
    for R in range(1, rows + 1):
        r = 2 * R - 1
        for C in range(1, columns + 1):
            c = 2 * C - 1
            if c + 1 < right.shape[1] - 1:
                coarse_right[R, C] = half * (right[r, c + 1] + right[r + 1, c + 1])
            if r + 1 < right.shape[0] - 1:
                coarse_down[R, C] = half * (down[r + 1, c] + down[r + 1, c + 1])
    return coarse_right, coarse_down


# The kernels below come in two drivers, parallel for fine levels and serial for coarse ones, over
# one body for a row.


@numba.njit(cache=True)
def _smooth_row(
    right: Float, down: Float, inverse: Float, b: Float, x: Float, r: int, first: int
) -> None:
    for c in range(first, right.shape[1] - 1, 2):
        x[r, c] = inverse[r, c] * (
            b[r, c]
            + right[r, c - 1] * x[r, c - 1]
            + right[r, c] * x[r, c + 1]
            + down[r - 1, c] * x[r - 1, c]
            + down[r, c] * x[r + 1, c]
        )


@numba.njit(parallel=True, cache=True)
def _smooth(right: Float, down: Float, inverse: Float, b: Float, x: Float, colour: int) -> None:
    for r in numba.prange(1, right.shape[0] - 1):
        _smooth_row(right, down, inverse, b, x, r, 1 + (r + colour) % 2)


@numba.njit(cache=True)
def _smooth_serial(
    right: Float, down: Float, inverse: Float, b: Float, x: Float, colour: int
) -> None:
    for r in range(1, right.shape[0] - 1):
        _smooth_row(right, down, inverse, b, x, r, 1 + (r + colour) % 2)


@numba.njit(cache=True)
def _residual_at(right: Float, down: Float, b: Float, x: Float, r: int, c: int) -> float:
    here = x[r, c]
    residual: float = (
        b[r, c]
        - right[r, c - 1] * (here - x[r, c - 1])
        - right[r, c] * (here - x[r, c + 1])
        - down[r - 1, c] * (here - x[r - 1, c])
        - down[r, c] * (here - x[r + 1, c])
    )
    return residual


@numba.njit(cache=True)
def _restrict_row(right: Float, down: Float, b: Float, x: Float, coarse: Float, R: int) -> None:
    rows, columns = right.shape
    for C in range(1, coarse.shape[1] - 1):
        total = np.float32(0)
        for r in range(2 * R - 1, min(2 * R + 1, rows - 1)):
            for c in range(2 * C - 1, min(2 * C + 1, columns - 1)):
                total += _residual_at(right, down, b, x, r, c)
        coarse[R, C] = total


@numba.njit(parallel=True, cache=True)
def _restrict(right: Float, down: Float, b: Float, x: Float, coarse: Float) -> None:
    for R in numba.prange(1, coarse.shape[0] - 1):
        _restrict_row(right, down, b, x, coarse, R)


@numba.njit(cache=True)
def _restrict_serial(right: Float, down: Float, b: Float, x: Float, coarse: Float) -> None:
    for R in range(1, coarse.shape[0] - 1):
        _restrict_row(right, down, b, x, coarse, R)


@numba.njit(cache=True)
def _prolong_row(coarse: Float, inverse: Float, x: Float, r: int) -> None:
    for c in range(1, x.shape[1] - 1):
        # Pixels without edges stay 0.
        if inverse[r, c] > 0:
            x[r, c] += coarse[(r + 1) // 2, (c + 1) // 2]


@numba.njit(parallel=True, cache=True)
def _prolong(coarse: Float, inverse: Float, x: Float) -> None:
    for r in numba.prange(1, x.shape[0] - 1):
        _prolong_row(coarse, inverse, x, r)


@numba.njit(cache=True)
def _prolong_serial(coarse: Float, inverse: Float, x: Float) -> None:
    for r in range(1, x.shape[0] - 1):
        _prolong_row(coarse, inverse, x, r)


# Vector work of the conjugate gradients. Sums are returned row by row, so that a total does not
# depend on the number of threads.


@numba.njit(parallel=True, cache=True)
def _dot(a: Double, b: Float) -> Double:
    sums = np.zeros(len(a), np.float64)
    for r in numba.prange(len(a)):
        total = 0.0
        for c in range(a.shape[1]):
            total += a[r, c] * b[r, c]
        sums[r] = total
    return sums


@numba.njit(parallel=True, cache=True)
def _add_scaled(direction: Double, correction: Float, factor: float) -> None:
    for r in numba.prange(len(direction)):
        for c in range(direction.shape[1]):
            direction[r, c] = correction[r, c] + factor * direction[r, c]


@numba.njit(parallel=True, cache=True)
def _step(u: Double, residual: Double, direction: Double, product: Double, length: float) -> Double:
    """Take a step and return the square of the new residual, row by row."""
    sums = np.zeros(len(u), np.float64)
    for r in numba.prange(len(u)):
        total = 0.0
        for c in range(u.shape[1]):
            u[r, c] += length * direction[r, c]
            value = residual[r, c] - length * product[r, c]
            residual[r, c] = value
            total += value * value
        sums[r] = total
    return sums
