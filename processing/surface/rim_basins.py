"""Pieces of a surface between rims, and the known heights on them.

A known height says nothing about pixels beyond a rim, but rims have gaps: where a jump follows a
row or a column, normals hardly show it. The pieces are the basins of the distance from rims; two of
them are one piece unless most of the border between them is a rim.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from scipy import ndimage

from processing.surface.jump_evidence import Pair
from processing.surface.placement import CRUMB, joined, linked
from rig.arrays import Bool, Float32, Float64, Int32, Int64

# Edges with less trust are at a rim, and a border with a larger share of them is one.
_TRUST, _RIM_SHARE = 0.5, 0.5


class Basins(NamedTuple):
    """Basins of the distance from rims, between all neighbours on a surface.

    Parameters
    ----------
    labels
        ``(H+2, W+2)`` int32 number of the basin of each pixel, -1 for pixels without edges.
    a, b
        ``(N,)`` int32 basins of two neighbours.
    rim
        ``(N,)`` bool, whether there is a rim between them.
    width
        ``(N,)`` float32 distance of the nearer one from a rim, in pixels, plus their trust.
    """

    labels: Int32
    a: Int32
    b: Int32
    rim: Bool
    width: Float32

    @classmethod
    def of(cls, edges: Pair, trust: Pair) -> Basins:
        """Return the basins of a surface.

        Parameters
        ----------
        edges, trust
            ``(H+2, W+2)`` weights of the edges to the right and down, and their trust, 0 to 1.
        """
        inside = linked(edges) > 0
        flat, ends, trusted = inside.ravel(), [], []
        for axis, step in enumerate((1, inside.shape[1])):
            here = np.flatnonzero(flat[:-step] & flat[step:])
            ends.append((here, here + step))
            # Normals that are opposed have no edge.
            trusted.append(np.where(edges[axis] > 0, trust[axis], np.float32(0)).ravel()[here])
        (a, b), sure = np.concatenate(ends, axis=1), np.concatenate(trusted)
        rim = sure < _TRUST
        clear = inside.astype(np.uint8)
        clear.ravel()[a[rim]] = clear.ravel()[b[rim]] = 0
        distance = np.asarray(cv2.distanceTransform(clear, cv2.DIST_L2, 5), np.float32).ravel()
        labels = np.full(inside.size, -1, np.int32)
        labels[flat] = np.unique(_summits(distance, a, b)[flat], return_inverse=True)[1]
        apart = labels[a] != labels[b]
        a, b = a[apart], b[apart]
        width = np.minimum(distance[a], distance[b]) + sure[apart]
        return cls(labels.reshape(inside.shape), labels[a], labels[b], rim[apart], width)

    def pieces(self) -> Int32:
        """Return ``(H+2, W+2)`` the number of the piece of each pixel, -1 without edges."""
        piece = self._pieces(np.arange(self.labels.max() + 1), -self.width)
        return np.where(self.labels >= 0, piece[self.labels], -1)

    def moved(self, u: Float64, target: Float64, known: Bool) -> Float64:
        """Return a surface whose pieces are moved to the median of their known heights.

        A basin without known heights belongs to the one beyond its widest passage; basins with like
        heights are joined first.

        Parameters
        ----------
        u
            ``(H+2, W+2)`` the surface.
        target, known
            ``(H+2, W+2)`` known heights, and where they are.
        """
        sizes = CRUMB * np.bincount(self.labels[known], minlength=self.labels.max() + 1)
        order = np.argsort(-self.width, kind="stable")
        roots = joined(self.a[order], self.b[order], sizes)
        off, own = (target - u)[known], roots[self.labels[known]]
        heights = np.zeros(len(roots))
        heights[own] = ndimage.median(off, own, own)
        piece = self._pieces(roots, np.abs(heights[roots[self.a]] - heights[roots[self.b]]))
        heights[piece[own]] = ndimage.median(off, piece[own], piece[own])
        return u + np.where(self.labels >= 0, heights[piece[roots[self.labels]]], 0.0)

    def _pieces(self, roots: Int32, order: Float32 | Float64) -> Int32:
        """Return which of the given roots of basins each of them belongs to.

        Of the ``(N,)`` neighbours, those with a lower order are joined first.
        """
        ends = np.sort(np.stack([roots[self.a], roots[self.b]], axis=1), axis=1)
        apart = np.flatnonzero(ends[:, 0] != ends[:, 1])
        apart = apart[np.argsort(order[apart], kind="stable")]
        codes, first, border = np.unique(
            ends[apart].astype(np.int64) @ (len(roots), 1), return_index=True, return_inverse=True
        )
        lengths = np.bincount(border), np.bincount(border[self.rim[apart]], minlength=len(codes))
        pairs = np.stack(np.divmod(codes, len(roots)), axis=1)
        around: list[dict[int, Int64]] = [{} for _ in roots]
        for (i, j), length in zip(pairs.tolist(), np.stack(lengths, axis=1), strict=True):
            around[i][j] = around[j][i] = length
        members = [[i] for i in range(len(roots))]
        piece = np.arange(len(roots), dtype=np.int32)
        for pair in pairs[np.argsort(first)]:
            i, j = piece[pair].tolist()
            if i == j or around[i][j][1] >= _RIM_SHARE * around[i][j][0]:
                continue
            if len(around[i]) < len(around[j]):
                i, j = j, i
            piece[members[j]] = i
            members[i] += members[j]
            for other, length in around[j].items():
                del around[other][j]
                if other != i:
                    around[i][other] = around[other][i] = length + around[i].get(other, 0)
        return piece


def _summits(distance: Float32, a: Int64, b: Int64) -> Int64:
    """Return the summit to which steepest ascent from each pixel leads."""
    summits, height = np.arange(distance.size), distance.copy()
    for low, high in ((a, b), (b, a)):
        for step in np.unique(high - low):
            some = high - low == step
            rises = some & (distance[high] > height[low])
            summits[low[rises]], height[low[rises]] = high[rises], distance[high[rises]]
    while not np.array_equal(summits, further := summits[summits]):
        summits = further
    return summits
