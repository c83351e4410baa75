"""Heights of the pieces of a surface relative to each other, from all edges between them.

Pieces hang together by edges that are trusted. Every other edge votes for the offset between two
pieces that makes it continuous. At a contact, many votes agree; along a jump, they scatter. The two
pieces whose votes agree best are put together, their votes about others are pooled, and so on.
"""

from __future__ import annotations

import numba
import numpy as np

from processing.surface.anchors import Anchors
from processing.surface.grid_graph import label_parts
from rig.arrays import Float32, Float64, Int32, Int64
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

Pair = tuple[Float32, Float32]

# Votes that differ by this much, in pixels, count a quarter for each other.
_AGREEING_PX = 0.5
# Smaller pieces, in pixels, are parts of the neighbour that they trust most.
_CRUMB = 30
# Pairs are put together in one round if their votes agree this well, relative to the best pair.
_AS_GOOD = 0.5
# Offsets of two pieces that are tried.
_TRIED = 200


def placed(
    u: Float64,
    steps: tuple[Float64, Float64],
    witness: Pair,
    trust: Pair,
    threshold: float,
    scale: float,
    held: Anchors | None = None,
) -> Float64:
    """Return a surface whose pieces are moved to where the edges between them agree.

    Parameters
    ----------
    u
        ``(H+2, W+2)`` the surface.
    steps
        ``(H+2, W+2)`` steps along the edges to the right and down.
    witness
        ``(H+2, W+2)`` weights of the votes, 0 without an edge.
    trust
        ``(H+2, W+2)`` trust of the edges, 0 to 1.
    threshold
        Edges with more trust hold a piece together.
    scale
        Pixels for a step of 1.
    held
        Known heights, which vote for the heights of their pieces.
    """
    pieces, count = _pieces(witness, trust, threshold)
    votes = [_votes(pieces, u, witness[axis], steps[axis], axis, scale) for axis in (0, 1)]
    inside = pieces >= 0
    if held is not None:
        known = np.flatnonzero(inside.ravel() & (held.weights.ravel() > 0))
        piece = pieces.ravel()[known]
        off = scale * (held.target - u).ravel()[known]
        weight = held.weights.ravel()[known].astype(np.float64)
        votes.append((np.full(len(piece), count, np.int32), piece, off, weight))
    a, b, offsets, weights = (np.concatenate(each) for each in zip(*votes, strict=True))
    # The last group is what the known heights belong to: it does not move.
    moves = _agreed(count + 1, a, b, offsets, weights)
    if held is not None:
        moves -= moves[count]
    found = u.copy()
    found[inside] += moves[pieces[inside]] / scale
    return found


def _pieces(witness: Pair, trust: Pair, threshold: float) -> tuple[Int32, int]:
    """Return the number of the piece of each pixel, -1 without edges, and how many there are."""
    strong = [np.where(each > threshold, each, np.float32(0)) for each in trust]
    labels, count = label_parts(*strong)
    alone = (labels < 0) & (_linked(witness) > 0)
    extra = int(np.count_nonzero(alone))
    labels[alone] = np.arange(count, count + extra, dtype=np.int32)
    count += extra
    ends = []
    for axis in (0, 1):
        here = np.flatnonzero((witness[axis] > 0) & (trust[axis] <= threshold))
        there = here + (labels.shape[1] if axis else 1)
        ends.append((labels.ravel()[here], labels.ravel()[there], trust[axis].ravel()[here]))
    a, b, trusted = (np.concatenate(each) for each in zip(*ends, strict=True))
    apart = a != b
    a, b, trusted = a[apart], b[apart], trusted[apart]
    order = np.argsort(-trusted, kind="stable")
    sizes = np.bincount(labels[labels >= 0], minlength=count)
    roots = _joined(a[order], b[order], sizes)
    numbers, members = np.unique(roots, return_inverse=True)
    labels[labels >= 0] = members[labels[labels >= 0]]
    return labels, len(numbers)


def _linked(witness: Pair) -> Float32:
    """Return the weights of all edges of each pixel."""
    total = witness[0] + witness[1]
    total[:, 1:] += witness[0][:, :-1]
    total[1:] += witness[1][:-1]
    return total


@numba.njit(cache=True)
def _joined(a: Int32, b: Int32, sizes: Int64) -> Int32:
    """Join crumbs to others along edges in the given order; return the root of each piece."""
    parent = np.arange(len(sizes)).astype(np.int32)
    for k in range(len(a)):
        i, j = a[k], b[k]
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        while parent[j] != j:
            parent[j] = parent[parent[j]]
            j = parent[j]
        if i != j and min(sizes[i], sizes[j]) < _CRUMB:
            if sizes[i] < sizes[j]:
                i, j = j, i
            parent[j] = i
            sizes[i] += sizes[j]
    for i in range(len(parent)):
        root = i
        while parent[root] != root:
            root = parent[root]
        parent[i] = root
    return parent


def _votes(
    pieces: Int32, u: Float64, witness: Float32, steps: Float64, axis: int, scale: float
) -> tuple[Int32, Int32, Float64, Float64]:
    """Return both pieces of the edges between pieces, the offset of the second, and the weight."""
    beside = pieces.shape[1] if axis else 1
    flat = pieces.ravel()
    here = np.flatnonzero(witness)
    here = here[flat[here] != flat[here + beside]]
    there = here + beside
    offsets = scale * (u.ravel()[here] + steps.ravel()[here] - u.ravel()[there])
    return flat[here], flat[there], offsets, witness.ravel()[here].astype(np.float64)


def _agreed(count: int, a: Int32, b: Int32, offsets: Float64, weights: Float64) -> Float64:
    """Return by how much each piece moves.

    In each round, those groups are put together whose votes agree at least half as well as those of
    the best pair.
    """
    group = np.arange(count, dtype=np.int32)
    moves = np.zeros(count)
    while len(a):
        swapped = a > b
        a, b = np.where(swapped, b, a), np.where(swapped, a, b)
        offsets = np.where(swapped, -offsets, offsets)
        order = np.lexsort((offsets, b, a))
        a, b, offsets, weights = a[order], b[order], offsets[order], weights[order]
        first = np.flatnonzero(np.append(True, (np.diff(a) != 0) | (np.diff(b) != 0)))
        agreement, best = _modes(np.append(first, len(a)), offsets, weights)
        order = np.argsort(-agreement, kind="stable")
        order = order[agreement[order] >= _AS_GOOD * agreement.max()]
        joined, shift = _put_together(count, a[first[order]], b[first[order]], best[order])
        moves += shift[group]
        group = joined[group]
        offsets = offsets - shift[b] + shift[a]
        a, b = joined[a], joined[b]
        apart = a != b
        a, b, offsets, weights = a[apart], b[apart], offsets[apart], weights[apart]
    return moves


@numba.njit(cache=True)
def _put_together(count: int, a: Int32, b: Int32, offsets: Float64) -> tuple[Int32, Float64]:
    """Put groups together pair by pair; return the first of each group, and how it moves."""
    parent = np.arange(count).astype(np.int32)
    shift = np.zeros(count)
    for k in range(len(a)):
        i, j = a[k], b[k]
        move = offsets[k]
        while parent[i] != i:
            move += shift[i]
            i = parent[i]
        while parent[j] != j:
            move -= shift[j]
            j = parent[j]
        if i != j:
            parent[j], shift[j] = i, move
    for start in range(count):
        i, total = start, 0.0
        while parent[i] != i:
            total += shift[i]
            i = parent[i]
        parent[start], shift[start] = i, total
    return parent, shift


@numba.njit(**PART)
def _agreeing(difference: float) -> float:
    weight: float = (1 + (difference / _AGREEING_PX) ** 2) ** -2
    return weight


@numba.njit(parallel=True, cache=True)
def _modes(first: Int64, offsets: Float64, weights: Float64) -> tuple[Float64, Float64]:
    """Return how well the sorted votes of each pair agree, and the offset on which they do.

    The measure is the weight that agrees, times its share of all weight.
    """
    pairs = len(first) - 1
    agreement, best = np.zeros(pairs), np.zeros(pairs)
    for pair in numba.prange(pairs):
        begin, end = first[pair], first[pair + 1]
        most, at = -1.0, 0.0
        for k in range(begin, end, (end - begin) // _TRIED + 1):
            total = 0.0
            for m in range(begin, end):
                total += weights[m] * _agreeing(offsets[m] - offsets[k])
            if total > most:
                most, at = total, offsets[k]
        everything = 0.0
        for _ in range(5):
            total, moment, everything = 0.0, 0.0, 0.0
            for m in range(begin, end):
                weight = weights[m] * _agreeing(offsets[m] - at)
                total += weight
                moment += weight * (offsets[m] - at)
                everything += weights[m]
            at += moment / max(total, 1e-300)
            most = total
        agreement[pair] = most * most / max(everything, 1e-300)
        best[pair] = at
    return agreement, best
