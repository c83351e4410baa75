"""Compiled loops over pixels that find jumps of a surface, for `processing.surface.jumps`.

The arrays have an empty border of one pixel, as in `processing.surface.grid_graph`.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from rig.arrays import Float32, Float64
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

# Beyond this exponent, a share is 0 or 1 in float32.
_LARGEST_EXPONENT = 50.0
# Least factor of the trust of the two pixels of an edge, and of the gate of its residual.
_LEAST = 0.03
# Least weight. Pieces that hang together by less would move by rounding errors.
_LEAST_WEIGHT = np.float32(1e-6)
# An edge that a surface contradicts by this much, in pixels, counts half.
_CONTRADICTING_PX = 0.5


@numba.njit(**PART)
def _share(exponent: float) -> float:
    limited = min(max(exponent, -_LARGEST_EXPONENT), _LARGEST_EXPONENT)
    return 1 / (1 + math.exp(-limited))


@numba.njit(parallel=True, cache=True)
def shares(
    u: Float64, right: Float32, down: Float32, facing: Float32, k: float, scale: float
) -> tuple[Float32, Float32]:
    """Return how much each pixel trusts its right and its lower neighbour.

    The two neighbours in a row (column) get shares with the sum 1: the one that is nearer in height
    gets more (Cao et al., 2022, eq. 13 to 16).

    Parameters
    ----------
    u
        ``(H+2, W+2)`` float64 surface.
    right, down
        ``(H+2, W+2)`` float32 edge weights; 0 means no edge.
    facing
        ``(H+2, W+2)`` float32 cosine between normal and line of sight.
    k
        Sharpness, in 1/px^2.
    scale
        Pixels for a step of 1 of ``u``.
    """
    rows, columns = u.shape
    share_right = np.full((rows, columns), np.float32(0.5))
    share_down = np.full((rows, columns), np.float32(0.5))
    for r in numba.prange(1, rows - 1):
        for c in range(1, columns - 1):
            # Differences along the line of the normal: slopes do not count as jumps.
            factor = k * (scale * facing[r, c]) ** 2
            here = u[r, c]
            # A neighbour without an opposite one is trusted: nothing contradicts it.
            if right[r, c - 1] > 0 and right[r, c] > 0:
                before, after = (here - u[r, c - 1]) ** 2, (here - u[r, c + 1]) ** 2
                share_right[r, c] = _share(factor * (before - after))
            if down[r - 1, c] > 0 and down[r, c] > 0:
                before, after = (here - u[r - 1, c]) ** 2, (here - u[r + 1, c]) ** 2
                share_down[r, c] = _share(factor * (before - after))
    return share_right, share_down


@numba.njit(parallel=True, cache=True)
def gated_weights(
    edges: Float32,
    facing: Float32,
    share: Float32,
    evenness: Float32,
    residual: Float32,
    vertical: int,
    width: float,
    least: float,
    out: Float32,
) -> None:
    """Write the weights of edges: those that both of their pixels trust and that fit the surface.

    Parameters
    ----------
    edges
        ``(H+2, W+2)`` float32, 0 means no edge.
    facing
        ``(H+2, W+2)`` float32 cosine between normal and line of sight.
    share
        ``(H+2, W+2)`` float32 share 0..1 of the right (lower) neighbour of each pixel.
    evenness
        ``(H+2, W+2)`` float32 weight 0..1 of each edge from the normals alone.
    residual
        ``(H+2, W+2)`` float32 residuals of the edges, see `residuals`.
    vertical
        1 for edges that point down, 0 for edges to the right.
    width
        Residual at which the weight is a quarter (Geman and McClure, 1987).
    least
        Least factor of trust and residual together.
    out
        ``(H+2, W+2)`` float32 weights.
    """
    rows, columns = edges.shape
    for r in numba.prange(1, rows - 1):
        q = r + vertical
        for c in range(1, columns - 1):
            if edges[r, c] <= 0:
                out[r, c] = 0
                continue
            d = c + 1 - vertical
            one, other = share[r, c], 1 - share[q, d]
            gate = _LEAST + (1 - _LEAST) * 2 * min(one, other)
            fit = max((1 + (residual[r, c] / width) ** 2) ** -2, _LEAST)
            facing2 = one * facing[r, c] ** 2 + other * facing[q, d] ** 2
            weight = max(gate * fit, least) * evenness[r, c] * facing2
            out[r, c] = max(weight, _LEAST_WEIGHT)


@numba.njit(parallel=True, cache=True)
def residuals(
    u: Float64, edges: Float32, steps: Float32, vertical: int, scale: float, out: Float32
) -> None:
    """Write by how much the surface differs from the step of each edge, 0 without an edge.

    The differences are in pixels and in units of their deviation: they are multiplied by the root
    of the weight of the chord rule.
    """
    rows, columns = edges.shape
    for r in numba.prange(1, rows - 1):
        q = r + vertical
        for c in range(1, columns - 1):
            off = u[q, c + 1 - vertical] - u[r, c] - steps[r, c]
            out[r, c] = scale * off * math.sqrt(edges[r, c])


@numba.njit(parallel=True, cache=True)
def imbalance(
    right: Float32, down: Float32, to_right: Float32, to_down: Float32, u: Float64
) -> Float64:
    """Return the right-hand side of the change of a surface that fits the weighted edges better.

    It is that of `processing.surface.grid_graph.divergence` for what the edges lack.
    """
    rows, columns = u.shape
    out = np.zeros((rows, columns), np.float64)
    for r in numba.prange(1, rows - 1):
        for c in range(1, columns - 1):
            here = u[r, c]
            total = right[r, c - 1] * (u[r, c - 1] + to_right[r, c - 1] - here)
            total -= right[r, c] * (here + to_right[r, c] - u[r, c + 1])
            total += down[r - 1, c] * (u[r - 1, c] + to_down[r - 1, c] - here)
            total -= down[r, c] * (here + to_down[r, c] - u[r + 1, c])
            out[r, c] = total
    return out


@numba.njit(parallel=True, cache=True)
def contradiction(
    u: Float64,
    witness: Float32,
    order: Float32,
    steps: Float32,
    vertical: int,
    scale: float,
) -> Float64:
    """Return, for each row, the sum of w r^2 / (r^2 + s^2) of the residuals r of its edges.

    The weight w is that of the witness, and that of the order if the residual has the same sign.

    Parameters
    ----------
    u
        ``(H+2, W+2)`` float64 surface.
    witness
        ``(H+2, W+2)`` float32 weights.
    order
        ``(H+2, W+2)`` float32 weights against positive residuals; negative: against negative ones.
    steps
        ``(H+2, W+2)`` float32 steps along the edges.
    vertical
        1 for edges that point down, 0 for edges to the right.
    scale
        Pixels for a step of 1.
    """
    rows, columns = witness.shape
    sums = np.zeros(rows, np.float64)
    for r in numba.prange(1, rows - 1):
        q = r + vertical
        total = 0.0
        for c in range(1, columns - 1):
            off = scale * (u[q, c + 1 - vertical] - u[r, c] - steps[r, c])
            weight = witness[r, c]
            if off * order[r, c] > 0:
                weight += abs(order[r, c])
            total += weight * off * off / (off * off + _CONTRADICTING_PX**2)
        sums[r] = total
    return sums


@numba.njit(parallel=True, cache=True)
def trust(edges: Float32, share: Float32, vertical: int, out: Float32) -> None:
    """Write how much the two pixels of each edge trust each other, 0 to 1; 0 without an edge."""
    rows, columns = edges.shape
    for r in numba.prange(1, rows - 1):
        q = r + vertical
        for c in range(1, columns - 1):
            if edges[r, c] > 0:
                other = 1 - share[q, c + 1 - vertical]
                out[r, c] = min(2 * min(share[r, c], other), 1.0)
            else:
                out[r, c] = 0
