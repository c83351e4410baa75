"""Xie 2014, a peer: surface from normals, from its published mathematics.

W. Xie, Y. Zhang, C. C. L. Wang and R. C.-K. Chung, "Surface-from-normals: a discrete geometry
processing approach", CVPR 2014, with the L2 norm. Every pixel is a facet with four corners, which
it shares with its neighbours. Local shaping moves the corners of each facet into the plane through
its centre at right angles to its normal. Global blending finds the heights of all corners whose
differences from the mean of each facet are, by least squares, those of the shaped facets. The two
alternate until the surface stands still.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph, linalg

from benchmarks.paper.peers.protocol import Peer
from rig.arrays import Bool, Float64, Int64

Shaping = Literal["sight", "nearest"]

# Corners of a facet from its centre: x to the right, y up, and (row, column) of the corner.
_X = np.array([-0.5, 0.5, -0.5, 0.5])
_Y = np.array([0.5, 0.5, -0.5, -0.5])
_ROWS, _COLUMNS = np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1])
_MOST_ROUNDS = 2000
_STILL_PX = 1e-4


def heights(normals: Float64, mask: Bool, shaping: Shaping = "sight") -> Float64:
    """Return the heights of an orthographic surface.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` vectors of any length that face the camera. For a perspective view, the third
        component is the cosine to the line of sight; the height is then -f log(depth).
    mask
        ``(H, W)`` bool.
    shaping
        Corners move along the line of sight, or to the nearest point of the plane.

    Returns
    -------
    Double
        ``(H, W)`` heights in pixels at the centres, NaN outside; the mean of each part is 0.
    """
    rows, columns = np.nonzero(mask)
    corner = (rows[:, None] + _ROWS) * (mask.shape[1] + 1) + columns[:, None] + _COLUMNS
    used, corner = np.unique(corner, return_inverse=True)
    corner = corner.reshape(-1, 4)
    n = normals[mask].astype(np.float64)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    facets = np.repeat(np.arange(len(rows)), 4)
    shape = (len(rows), len(used))
    sums = sparse.csr_array((np.ones(facets.size), (facets, corner.ravel())), shape)
    # The sum over facets of the squared differences from their means.
    normal: sparse.dia_array = sparse.diags_array(np.asarray(sums.sum(axis=0))) - 0.25 * (
        sums.T @ sums
    )
    fixed = _first_of_parts(corner, len(used))
    free = np.setdiff1d(np.arange(len(used)), fixed)
    matrix = sparse.csc_array(normal.tocsr()[free][:, free])
    solve = linalg.splu(
        matrix, "MMD_AT_PLUS_A", diag_pivot_thresh=0, options={"SymmetricMode": True}
    )
    z = np.zeros(len(used))
    lateral = n[:, :1] * _X + n[:, 1:2] * _Y
    for _ in range(_MOST_ROUNDS):
        differences = z[corner] - z[corner].mean(axis=1, keepdims=True)
        if shaping == "sight":
            shaped = -lateral / n[:, 2:]
        else:
            shaped = differences - n[:, 2:] * (lateral + n[:, 2:] * differences)
        flow = np.bincount(corner.ravel(), shaped.ravel(), len(used))
        last, z = z, np.zeros(len(used))
        z[free] = solve.solve(flow[free])
        if shaping == "sight" or np.abs(z - last).mean() < _STILL_PX:
            break
    out = np.full(mask.shape, np.nan)
    out[mask] = z[corner].mean(axis=1)
    return out


def _first_of_parts(corner: Int64, count: int) -> Int64:
    """Return one corner of each part; facets hang together also by one corner."""
    ends = np.repeat(corner[:, 0], 3), corner[:, 1:].ravel()
    links = sparse.coo_array((np.ones(len(ends[0])), ends), (count, count))
    _, labels = csgraph.connected_components(links, directed=False)
    first: Int64 = np.unique(labels, return_index=True)[1]
    return first


def _fit(shaping: Shaping) -> Callable[[tuple[Float64, Bool]], Float64]:
    return lambda given: heights(*given, shaping)


PEER = Peer("Xie 2014", "Xie, Zhang, Wang and Chung, CVPR 2014", _fit)
