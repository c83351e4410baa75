"""Heights of the pieces of a surface relative to each other, from all edges between them.

Pieces hang together by edges that are trusted. Every other edge votes for the offset between two
pieces that makes it continuous. At a contact, many votes agree; along a jump, they scatter.
"""

from __future__ import annotations

import numba
import numpy as np

from processing.surface.grid_graph import label_parts
from processing.surface.jump_evidence import JumpEvidence, Pair
from processing.surface.piece_heights import Votes, agreed
from rig.arrays import Float32, Float64, Int32, Int64

# Edges with more trust hold a piece together.
_FIRM = 0.9
# Smaller pieces, in pixels, are parts of the neighbour that they trust most.
CRUMB = 30


def placed(
    u: Float64,
    steps: tuple[Float32, Float32],
    evidence: JumpEvidence,
    trust: Pair,
    width: float,
    scale: float,
) -> Float64:
    """Return a surface whose pieces are moved to where the edges between them agree.

    Parameters
    ----------
    u
        ``(H+2, W+2)`` the surface.
    steps
        ``(H+2, W+2)`` steps along the edges to the right and down.
    evidence
        What the normals say about jumps: weights of the votes.
    trust
        ``(H+2, W+2)`` trust of the edges, 0 to 1.
    width
        Votes within this width, in pixels, agree at first.
    scale
        Pixels for a step of 1.
    """
    pieces, count = _pieces(evidence.witness, trust)
    votes = [
        _votes(pieces, scale * u, evidence.witness[axis], evidence.order[axis], scale * step, axis)
        for axis, step in enumerate(steps)
    ]
    inside = pieces >= 0
    moves = agreed(count, Votes(*map(np.concatenate, zip(*votes, strict=True))), width)
    found = u.copy()
    found[inside] += moves[pieces[inside]] / scale
    return found


def _pieces(witness: Pair, trust: Pair) -> tuple[Int32, int]:
    """Return the number of the piece of each pixel, -1 without edges, and how many there are."""
    strong = [np.where(each > _FIRM, each, np.float32(0)) for each in trust]
    labels, count = label_parts(*strong)
    alone = (labels < 0) & (linked(witness) > 0)
    extra = int(np.count_nonzero(alone))
    labels[alone] = np.arange(count, count + extra, dtype=np.int32)
    count += extra
    ends = []
    for axis in (0, 1):
        here = np.flatnonzero((witness[axis] > 0) & (trust[axis] <= _FIRM))
        there = here + (labels.shape[1] if axis else 1)
        ends.append((labels.ravel()[here], labels.ravel()[there], trust[axis].ravel()[here]))
    a, b, trusted = (np.concatenate(each) for each in zip(*ends, strict=True))
    apart = a != b
    a, b, trusted = a[apart], b[apart], trusted[apart]
    order = np.argsort(-trusted, kind="stable")
    sizes = np.bincount(labels[labels >= 0], minlength=count)
    roots = joined(a[order], b[order], sizes)
    numbers, members = np.unique(roots, return_inverse=True)
    labels[labels >= 0] = members[labels[labels >= 0]]
    return labels, len(numbers)


def linked(weights: Pair) -> Float32:
    """Return the sum of the weights of all edges of each pixel."""
    total = weights[0] + weights[1]
    total[:, 1:] += weights[0][:, :-1]
    total[1:] += weights[1][:-1]
    return total


@numba.njit(cache=True)
def joined(a: Int32, b: Int32, sizes: Int64) -> Int32:
    """Join crumbs to others along edges in the given order; return the root of each piece.

    Parameters
    ----------
    a, b
        Both ends of each edge.
    sizes
        Size of each end. Ends of `CRUMB` and more are not joined with each other.
    """
    parent = np.arange(len(sizes)).astype(np.int32)
    for k in range(len(a)):
        i, j = a[k], b[k]
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        while parent[j] != j:
            parent[j] = parent[parent[j]]
            j = parent[j]
        if i != j and min(sizes[i], sizes[j]) < CRUMB:
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
    pieces: Int32, u: Float64, witness: Float32, order: Float32, steps: Float32, axis: int
) -> Votes:
    """Return the votes of the edges between pieces of a surface in pixels."""
    beside = pieces.shape[1] if axis else 1
    flat = pieces.ravel()
    here = np.flatnonzero(witness)
    here = here[flat[here] != flat[here + beside]]
    there = here + beside
    return Votes(
        flat[here].astype(np.int64),
        flat[there].astype(np.int64),
        u.ravel()[here] + steps.ravel()[here] - u.ravel()[there],
        witness.ravel()[here].astype(np.float64),
        order.ravel()[here].astype(np.float64),
    )
