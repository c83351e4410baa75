"""Graphs on thin masks, such as mazes: passages of one or two pixels.

Squares of pixels are poor coarse pixels there, because they connect passages that a wall separates:
multigrid needs hundreds of iterations. Elimination of one pixel after the other is exact, and
costs little, since few passages meet at any place. On wide masks, it would need too much memory.
"""

from __future__ import annotations

import numpy as np

from processing.surface.grid_graph import label_parts
from rig.arrays import Float32, Float64

# Largest share of pixels with eight neighbours.
_WIDE = 0.01


def is_thin(right: Float32, down: Float32) -> bool:
    """Return whether almost no pixel is in the middle of 3 x 3 connected pixels."""
    square = (right[:-1, :-1] > 0) & (right[1:, :-1] > 0) & (down[:-1, :-1] > 0)
    square &= down[:-1, 1:] > 0
    middle = square[:-1, :-1] & square[:-1, 1:] & square[1:, :-1] & square[1:, 1:]
    return bool(np.count_nonzero(middle) < _WIDE * np.count_nonzero((right > 0) | (down > 0)))


def solve_thin(
    right: Float32, down: Float32, b: Float64, anchors: Float32 | None = None
) -> Float64:
    """Solve (L + A) u = b for the graph Laplacian L and anchors A by sparse elimination.

    Parameters
    ----------
    right, down
        ``(H+2, W+2)`` edge weights.
    b
        ``(H+2, W+2)`` right-hand side, with the sum 0 over each part without anchors.
    anchors
        ``(H+2, W+2)`` weights of pixels, the diagonal of A; default: none.

    Returns
    -------
    Double
        ``(H+2, W+2)`` solution, 0 at the first pixel of each part without anchors and at pixels
        without edges.
    """
    # Imported here: it takes 0.3 s, and few masks are thin.
    from scipy import sparse
    from scipy.sparse import linalg

    labels, _ = label_parts(right, down)
    free = labels.ravel() >= 0
    numbers, first = np.unique(labels, return_index=True)
    diagonal = np.zeros(right.size)
    if anchors is not None:
        diagonal += anchors.ravel()
        first = first[~np.isin(numbers, labels[anchors > 0])]
    free[first] = False
    count = int(np.count_nonzero(free))
    number = np.full(right.size, -1, np.int32)
    number[free] = np.arange(count, dtype=np.int32)
    i, j, w = [], [], []
    for weights, offset in ((right, 1), (down, right.shape[1])):
        here = np.flatnonzero(weights)
        weight = weights.ravel()[here].astype(np.float64)
        diagonal[here] += weight
        diagonal[here + offset] += weight
        inner = free[here] & free[here + offset]
        i.append(number[here[inner]])
        j.append(number[here[inner] + offset])
        w.append(weight[inner])
    rows, columns, values = np.concatenate(i), np.concatenate(j), -np.concatenate(w)
    upper = sparse.coo_array((values, (rows, columns)), (count, count))
    matrix = sparse.csc_array(sparse.diags_array(diagonal[free]) + upper + upper.T)
    symmetric = {"SymmetricMode": True}
    factors = linalg.splu(matrix, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)
    u = np.zeros(right.size)
    u[free] = factors.solve(b.ravel()[free])
    return u.reshape(right.shape)
