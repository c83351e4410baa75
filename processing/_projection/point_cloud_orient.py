"""Orientation of the normals of a point cloud, propagated from the points in front."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

Double = npt.NDArray[np.float64]

_NEIGHBOURS = 8
# Keeps paths short if all normals are parallel.
_STEP = 1e-3


def orient(points: Double, normals: Double, front: npt.NDArray[np.bool_]) -> Double:
    """Propagate the orientation of the points in front to all other points.

    A point takes its orientation from the previous point on the path from the front along which the
    normals change least (after Hoppe et al., 1992, who grow one tree from one point).

    Parameters
    ----------
    points
        ``(N, 3)``.
    normals
        ``(N, 3)`` unit vectors; of either sign for points that are not in front.
    front
        ``(N,)``, True for points whose sign is correct.

    Returns
    -------
    Double
        ``(N, 3)`` normals; points without a path from the front keep their normals.
    """
    count = min(_NEIGHBOURS, len(points))
    _, near = cKDTree(points).query(points, count)
    # Normals of a few digits may be longer than 1, and negative lengths of paths never end.
    bend = np.maximum(1 - np.abs(np.einsum("nki,ni->nk", normals[near], normals)), -_STEP) + _STEP
    begin = np.arange(len(points) + 1) * count
    graph = csr_array((bend.ravel(), near.ravel(), begin), (len(points), len(points)))
    length, before, _ = dijkstra(
        graph, directed=False, indices=np.flatnonzero(front), return_predecessors=True,
        min_only=True,
    )  # fmt: skip
    order = np.argsort(length, kind="stable")
    oriented = normals.copy()
    _carry(oriented, before.astype(np.int64), order[~front[order]])
    return oriented


@numba.njit(cache=True)
def _carry(normals: Double, before: npt.NDArray[np.int64], order: npt.NDArray[np.int64]) -> None:
    for i in order:
        j = before[i]
        if j >= 0:
            dot = 0.0
            for axis in range(3):
                dot += normals[i, axis] * normals[j, axis]
            if dot < 0:
                for axis in range(3):
                    normals[i, axis] = -normals[i, axis]
