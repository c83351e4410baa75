"""Which part of a surface each known height belongs to, between rims that the normals show.

A known height says nothing about pixels beyond a rim, but rims have gaps: where a jump follows a
row or a column, normals hardly show it. The pieces are the basins of the distance from rims, each
with the known heights at its summit; two of them are one piece unless most of the border between
them is a rim.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage

from processing.surface.jump_evidence import SURE, Pair
from processing.surface.placement import CRUMB, joined
from rig.arrays import Bool, Float32, Float64, Int32, Int64

# A border is a rim if the normals show a jump along this share of it.
_RIM_SHARE = 0.5


def moved_to_known(
    u: Float64, target: Float64, known: Bool, edges: Pair, continuity: Pair
) -> Float64:
    """Return a surface whose pieces are moved to the median of their known heights.

    Parameters
    ----------
    u
        ``(H+2, W+2)`` the surface.
    target, known
        ``(H+2, W+2)`` known heights, and where they are.
    edges, continuity
        ``(H+2, W+2)`` weights of the edges to the right and down, and the probabilities that they
        are continuous.
    """
    across, along = (np.flatnonzero(edge) for edge in edges)
    a = np.concatenate([across, along])
    b = np.concatenate([across + 1, along + u.shape[1]])
    sure = np.concatenate([continuity[0].ravel()[across], continuity[1].ravel()[along]])
    suspect = sure < SURE
    clear = np.zeros(u.size, np.uint8)
    clear[a] = clear[b] = 1
    clear[a[suspect]] = clear[b[suspect]] = 0
    distance = np.asarray(cv2.distanceTransform(clear.reshape(u.shape), cv2.DIST_L2, 5), np.float32)
    at = np.flatnonzero(known)
    basins = _basins(distance.ravel(), at, a, b)
    seeds, own = np.unique(basins[at], return_inverse=True)
    off = (target - u).ravel()[at]
    heights = ndimage.median(off, own, np.arange(len(seeds)))
    labels = np.where(np.isin(basins, seeds), np.searchsorted(seeds, basins), -1)
    piece = _joined_basins(heights, labels[a], labels[b], suspect)
    moves = ndimage.median(off, piece[own], np.arange(len(seeds)))
    return u + np.where(labels >= 0, moves[piece[labels]], 0.0).reshape(u.shape)


def _basins(distance: Float32, known: Int64, a: Int64, b: Int64) -> Int32:
    """Return a pixel of the basin of each pixel; known heights at the same summit share theirs."""
    summits, height = np.arange(distance.size), distance.copy()
    for low, high in ((a, b), (b, a)):
        for step in np.unique(high - low):
            some = high - low == step
            rises = some & (distance[high] > height[low])
            summits[low[rises]], height[low[rises]] = high[rises], distance[high[rises]]
    while not np.array_equal(summits, further := summits[summits]):
        summits = further
    sizes = np.zeros(distance.size, np.int64)
    sizes[summits[known]] = CRUMB
    # From the widest passage on, a basin without known heights belongs to the one beyond it.
    order = np.argsort(-np.minimum(distance[a], distance[b]), kind="stable")
    ends = summits[a[order]].astype(np.int32), summits[b[order]].astype(np.int32)
    return joined(*ends, sizes)[summits]


def _joined_basins(heights: Float64, a: Int64, b: Int64, suspect: Bool) -> Int64:
    """Return the piece of each basin; those with like heights are joined first."""
    apart = (a != b) & (np.minimum(a, b) >= 0)
    pairs, number = np.unique(
        np.sort(np.stack([a[apart], b[apart]]), axis=0), axis=1, return_inverse=True
    )
    lengths, rims = np.bincount(number), np.bincount(number, suspect[apart])
    borders: list[dict[int, Float64]] = [{} for _ in heights]
    for (i, j), length, rim in zip(pairs.T.tolist(), lengths, rims, strict=True):
        borders[i][j] = borders[j][i] = np.array([length, rim])
    piece = np.arange(len(heights))
    for pair in np.argsort(np.abs(np.diff(heights[pairs], axis=0)[0]), kind="stable"):
        i, j = piece[pairs[:, pair]].tolist()
        if i == j or borders[i][j][1] >= _RIM_SHARE * borders[i][j][0]:
            continue
        piece[piece == j] = i
        for other, border in borders[j].items():
            del borders[other][j]
            if other != i:
                borders[i][other] = borders[other][i] = border + borders[i].get(other, 0)
    return piece
