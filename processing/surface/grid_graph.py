"""Weighted graphs on the pixel grid: connected parts and the graph Laplacian.

A graph is two arrays of edge weights, ``right[r, c]`` between (r, c) and (r, c+1) and
``down[r, c]`` between (r, c) and (r+1, c); 0 means no edge. All arrays have a border of one pixel
without edges on every side, so the kernels require no bounds checks.
"""

from __future__ import annotations

import numba
import numpy as np

from rig.arrays import Float32, Float64, Int32
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7


@numba.njit(**PART)
def _find(parent: Int32, node: int) -> int:
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@numba.njit(cache=True)
def label_parts(right: Float32, down: Float32) -> tuple[Int32, int]:
    """Label the connected parts of a graph by union-find.

    Parameters
    ----------
    right, down
        ``(H+2, W+2)`` edge weights.

    Returns
    -------
    labels
        ``(H+2, W+2)`` part of each pixel, numbered from 0 in reading order; -1 for a pixel without
        edges.
    count
        Number of parts.
    """
    rows, columns = right.shape
    parent = np.arange(rows * columns, dtype=np.int32)
    for r in range(1, rows - 1):
        for c in range(1, columns - 1):
            node = r * columns + c
            if right[r, c] > 0:
                a, b = _find(parent, node), _find(parent, node + 1)
                parent[max(a, b)] = min(a, b)
            if down[r, c] > 0:
                a, b = _find(parent, node), _find(parent, node + columns)
                parent[max(a, b)] = min(a, b)
    labels = np.full((rows, columns), -1, np.int32)
    count = 0
    for r in range(1, rows - 1):
        for c in range(1, columns - 1):
            if right[r, c] + right[r, c - 1] + down[r, c] + down[r - 1, c] > 0:
                node = r * columns + c
                root = _find(parent, node)
                # The root is the first pixel of the part: it is this pixel or already labelled.
                if root == node:
                    labels[r, c] = count
                    count += 1
                else:
                    labels[r, c] = labels[root // columns, root % columns]
    return labels, count


def divergence(right: Float32, down: Float32, step_right: Float64, step_down: Float64) -> Float64:
    """Return the right-hand side of the least-squares problem for steps g along the edges.

    The minimum of sum w (u_j - u_i - g)^2 over the edges solves L u = b with the graph Laplacian L.
    b_i is the sum of w g over the edges that end at i minus the sum over those that start there.
    The sum of b over a connected part is 0.

    Parameters
    ----------
    right, down
        ``(H+2, W+2)`` edge weights.
    step_right, step_down
        ``(H+2, W+2)`` target differences u_j - u_i along the edges.

    Returns
    -------
    Double
        ``(H+2, W+2)`` right-hand side b.
    """
    flow = right * step_right
    out = -flow
    out[:, 1:] += flow[:, :-1]
    flow = down * step_down
    out -= flow
    out[1:] += flow[:-1]
    return out


@numba.njit(parallel=True, cache=True)
def apply_laplacian(right: Float32, down: Float32, u: Float64, out: Float64) -> Float64:
    """Write the graph Laplacian of `u` to `out` and return the products u . out of each row."""
    rows, columns = right.shape
    sums = np.zeros(rows, np.float64)
    for r in numba.prange(1, rows - 1):
        total = 0.0
        for c in range(1, columns - 1):
            here = u[r, c]
            value = (
                float(right[r, c - 1]) * (here - u[r, c - 1])
                + float(right[r, c]) * (here - u[r, c + 1])
                + float(down[r - 1, c]) * (here - u[r - 1, c])
                + float(down[r, c]) * (here - u[r + 1, c])
            )
            out[r, c] = value
            total += here * value
        sums[r] = total
    return sums
