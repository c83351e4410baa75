"""Compiled loops over pixels for the multigrid solver.

The arrays are those of `processing.surface.grid_graph`, with an empty border of one pixel: float32
inside the cycle, float64 in the conjugate gradients.
"""

from __future__ import annotations

import numba
import numpy as np

from rig.arrays import Float32, Float64
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7


@numba.njit(cache=True)
def aggregate(right: Float32, down: Float32) -> tuple[Float32, Float32]:
    """Return the edge weights of the next coarser level."""
    rows, columns = (right.shape[0] - 1) // 2, (right.shape[1] - 1) // 2
    coarse_right = np.zeros((rows + 2, columns + 2), np.float32)
    coarse_down = np.zeros((rows + 2, columns + 2), np.float32)
    half = np.float32(0.5)
    # Coarse row R contains the fine rows 2R-1 and 2R; an odd last row is paired with the empty
    # border.
    for R in range(1, rows + 1):
        r = 2 * R - 1
        for C in range(1, columns + 1):
            c = 2 * C - 1
            if c + 1 < right.shape[1] - 1:
                coarse_right[R, C] = half * (right[r, c + 1] + right[r + 1, c + 1])
            if r + 1 < right.shape[0] - 1:
                coarse_down[R, C] = half * (down[r + 1, c] + down[r + 1, c + 1])
    return coarse_right, coarse_down


# Each kernel below has two drivers that share the code for one row: a parallel driver for fine
# levels and a serial driver for coarse levels.


@numba.njit(**PART)
def _smooth_row(
    right: Float32, down: Float32, inverse: Float32, b: Float32, x: Float32, r: int, first: int
) -> None:
    for c in range(first, right.shape[1] - 1, 2):
        x[r, c] = inverse[r, c] * (
            b[r, c]
            + right[r, c - 1] * x[r, c - 1]
            + right[r, c] * x[r, c + 1]
            + down[r - 1, c] * x[r - 1, c]
            + down[r, c] * x[r + 1, c]
        )


@numba.njit(**PART)
def _begin_row(inverse: Float32, b: Float32, x: Float32, r: int) -> None:
    for c in range(1, x.shape[1] - 1):
        x[r, c] = inverse[r, c] * b[r, c] if (r + c) % 2 else 0


@numba.njit(parallel=True, cache=True)
def smooth(
    right: Float32, down: Float32, inverse: Float32, b: Float32, x: Float32, colour: int
) -> None:
    """Relax the pixels of one colour of the checkerboard (Gauss-Seidel)."""
    for r in numba.prange(1, right.shape[0] - 1):
        _smooth_row(right, down, inverse, b, x, r, 1 + (r + colour) % 2)


@numba.njit(cache=True)
def smooth_serial(
    right: Float32, down: Float32, inverse: Float32, b: Float32, x: Float32, colour: int
) -> None:
    """Relax like `smooth`, on one thread."""
    for r in range(1, right.shape[0] - 1):
        _smooth_row(right, down, inverse, b, x, r, 1 + (r + colour) % 2)


@numba.njit(parallel=True, cache=True)
def begin(inverse: Float32, b: Float32, x: Float32) -> None:
    """Replace x by 0, with the pixels of colour 0 relaxed."""
    for r in numba.prange(1, x.shape[0] - 1):
        _begin_row(inverse, b, x, r)


@numba.njit(cache=True)
def begin_serial(inverse: Float32, b: Float32, x: Float32) -> None:
    """Begin like `begin`, on one thread."""
    for r in range(1, x.shape[0] - 1):
        _begin_row(inverse, b, x, r)


@numba.njit(**PART)
def _residual_at(right: Float32, down: Float32, b: Float32, x: Float32, r: int, c: int) -> float:
    here = x[r, c]
    residual: float = (
        b[r, c]
        - right[r, c - 1] * (here - x[r, c - 1])
        - right[r, c] * (here - x[r, c + 1])
        - down[r - 1, c] * (here - x[r - 1, c])
        - down[r, c] * (here - x[r + 1, c])
    )
    return residual


@numba.njit(**PART)
def _restrict_row(
    right: Float32, down: Float32, b: Float32, x: Float32, coarse: Float32, R: int
) -> None:
    rows, columns = right.shape
    r = 2 * R - 1
    paired = r + 1 < rows - 1
    for C in range(1, coarse.shape[1] - 1):
        c = 2 * C - 1
        total = np.float32(0)
        if c + 1 < columns - 1:
            total += _residual_at(right, down, b, x, r, c + 1)
        if paired:
            total += _residual_at(right, down, b, x, r + 1, c)
        coarse[R, C] = total


@numba.njit(parallel=True, cache=True)
def restrict(right: Float32, down: Float32, b: Float32, x: Float32, coarse: Float32) -> None:
    """Sum the residual b - L x of the pixels of colour 0 of each 2 x 2 pixels into `coarse`.

    After a relaxation of colour 1, the residual of its pixels is 0.
    """
    for R in numba.prange(1, coarse.shape[0] - 1):
        _restrict_row(right, down, b, x, coarse, R)


@numba.njit(cache=True)
def restrict_serial(right: Float32, down: Float32, b: Float32, x: Float32, coarse: Float32) -> None:
    """Sum like `restrict`, on one thread."""
    for R in range(1, coarse.shape[0] - 1):
        _restrict_row(right, down, b, x, coarse, R)


@numba.njit(**PART)
def _prolong_row(coarse: Float32, inverse: Float32, x: Float32, r: int) -> None:
    for c in range(1, x.shape[1] - 1):
        # Pixels without edges remain 0.
        if inverse[r, c] > 0:
            x[r, c] += coarse[(r + 1) // 2, (c + 1) // 2]


@numba.njit(parallel=True, cache=True)
def prolong(coarse: Float32, inverse: Float32, x: Float32) -> None:
    """Add the correction of each coarse pixel to its 2 x 2 fine pixels."""
    for r in numba.prange(1, x.shape[0] - 1):
        _prolong_row(coarse, inverse, x, r)


@numba.njit(cache=True)
def prolong_serial(coarse: Float32, inverse: Float32, x: Float32) -> None:
    """Add like `prolong`, on one thread."""
    for r in range(1, x.shape[0] - 1):
        _prolong_row(coarse, inverse, x, r)


# Vector operations of the conjugate gradients. Sums are returned for each row, so totals do not
# depend on the number of threads.


@numba.njit(parallel=True, cache=True)
def dot(a: Float64, b: Float32) -> Float64:
    """Return the dot product of each row of a and b."""
    sums = np.zeros(len(a), np.float64)
    for r in numba.prange(len(a)):
        total = 0.0
        for c in range(a.shape[1]):
            total += a[r, c] * b[r, c]
        sums[r] = total
    return sums


@numba.njit(parallel=True, cache=True)
def add_anchors(anchors: Float32, u: Float64, product: Float64) -> Float64:
    """Add anchors * u to the product, and return u . (anchors * u) of each row."""
    sums = np.zeros(len(u), np.float64)
    for r in numba.prange(len(u)):
        total = 0.0
        for c in range(u.shape[1]):
            value = anchors[r, c] * u[r, c]
            product[r, c] += value
            total += u[r, c] * value
        sums[r] = total
    return sums


@numba.njit(parallel=True, cache=True)
def add_scaled(direction: Float64, correction: Float32, factor: float) -> None:
    """Replace the direction by the correction plus `factor` times the direction."""
    for r in numba.prange(len(direction)):
        for c in range(direction.shape[1]):
            direction[r, c] = correction[r, c] + factor * direction[r, c]


@numba.njit(parallel=True, cache=True)
def step(
    u: Float64, residual: Float64, direction: Float64, product: Float64, length: float
) -> Float64:
    """Take a step and return the squared norm of the new residual for each row."""
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
