"""Heights of pieces at which the edges between them contradict each other least.

A vote is the height of one piece above another that makes an edge between them continuous. It has
an agreeing weight, which is lost at other heights, and an order: a weight against heights on one
side, where the piece that hides the other would be behind it. Each of the pieces, and each half of
the tree of those that agree best, moves to the height with the least sum, until none gains.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from rig.arrays import Float64, Int64
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

# Votes that differ by this much, in pixels, agree half.
_AGREEING_PX = 0.5
# Least gain of a move, in edges that face the viewer.
_LEAST_GAIN = 0.3
# Heights of a group of pieces that are tried, and how often all groups are.
_TRIED, _SWEEPS = 200, 30


class Votes(NamedTuple):
    """Votes about the heights of pieces.

    Parameters
    ----------
    a, b
        Both pieces.
    offsets
        By how much the second must rise relative to the first for the edge to be continuous.
    weights
        Agreeing weights.
    order
        Weights against more (positive) or less (negative) than that.
    """

    a: Int64
    b: Int64
    offsets: Float64
    weights: Float64
    order: Float64

    def by_pair(self) -> Votes:
        """Return the same votes with the smaller piece first, in the order of their pairs."""
        swapped = self.a > self.b
        a, b = np.where(swapped, self.b, self.a), np.where(swapped, self.a, self.b)
        sign = np.where(swapped, -1.0, 1.0)
        order = np.lexsort((b, a))
        return Votes(
            a[order],
            b[order],
            (sign * self.offsets)[order],
            self.weights[order],
            (sign * self.order)[order],
        )


def agreed(count: int, votes: Votes, width: float) -> Float64:
    """Return by how much each of the pieces rises.

    Votes that differ by the given width, in pixels, agree half at first.
    """
    moves = np.zeros(count)
    votes = votes.by_pair()
    a, b = votes.a, votes.b
    first = np.flatnonzero(np.append(len(a) > 0, (np.diff(a) != 0) | (np.diff(b) != 0)))
    first = np.append(first, len(a))
    for within in sorted({width, _AGREEING_PX}, reverse=True):
        for _ in range(_SWEEPS):
            agreeing = _agreeing(moves, a, b, votes.offsets, votes.weights, first, within)
            pairs = np.argsort(-agreeing, kind="stable")
            places, sizes = _tree(count, a[first[pairs]], b[first[pairs]])
            if not _sweep(moves, places, sizes, *votes, within):
                break
    return moves


@numba.njit(**PART)
def _off(difference: float, width: float) -> float:
    """Return the share of a vote that is lost, 0 to 1."""
    off = difference * difference
    share: float = off / (off + width * width)
    return share


@numba.njit(cache=True)
def _agreeing(
    moves: Float64,
    a: Int64,
    b: Int64,
    offsets: Float64,
    weights: Float64,
    first: Int64,
    width: float,
) -> Float64:
    """Return the weight of the votes of each pair that agree with the heights."""
    total = np.zeros(len(first) - 1)
    for pair in range(len(first) - 1):
        for k in range(first[pair], first[pair + 1]):
            off = moves[b[k]] - moves[a[k]] - offsets[k]
            total[pair] += weights[k] * (1 - _off(off, width))
    return total


@numba.njit(cache=True)
def _tree(count: int, a: Int64, b: Int64) -> tuple[Int64, Int64]:
    """Return the place of each piece in the trees of the first pairs, and the sizes of branches.

    A branch consists of the pieces from that at its root on, by their places.
    """
    parent = np.arange(count)
    degree = np.zeros(count + 1, np.int64)
    chosen = np.zeros(len(a), np.bool_)
    for k in range(len(a)):
        i, j = a[k], b[k]
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        while parent[j] != j:
            parent[j] = parent[parent[j]]
            j = parent[j]
        if i != j:
            parent[j], chosen[k] = i, True
            degree[a[k] + 1] += 1
            degree[b[k] + 1] += 1
    first = np.cumsum(degree)
    end = first[:-1].copy()
    beside = np.zeros(first[-1], np.int64)
    for k in range(len(a)):
        if chosen[k]:
            beside[end[a[k]]], beside[end[b[k]]] = b[k], a[k]
            end[a[k]] += 1
            end[b[k]] += 1
    places, sizes = np.full(count, -1), np.ones(count, np.int64)
    above, sequence, stack = (
        np.full(count, -1),
        np.zeros(count, np.int64),
        np.zeros(count, np.int64),
    )
    place = 0
    for root in range(count):
        if places[root] >= 0:
            continue
        stack[0], top = root, 1
        while top:
            top -= 1
            i = stack[top]
            places[i], sequence[place] = place, i
            place += 1
            for j in beside[first[i] : end[i]]:
                if j != above[i]:
                    above[j], stack[top] = i, j
                    top += 1
    for i in sequence[::-1]:
        if above[i] >= 0:
            sizes[above[i]] += sizes[i]
    return places, sizes


@numba.njit(cache=True)
def _sweep(
    moves: Float64,
    places: Int64,
    sizes: Int64,
    a: Int64,
    b: Int64,
    offsets: Float64,
    weights: Float64,
    order: Float64,
    width: float,
) -> bool:
    """Move each branch, and each piece, to its best height; return whether any gained."""
    count, gained = len(moves), False
    near, agreeing, against = np.zeros((3, len(a)))
    pieces = np.argsort(places)
    for k in range(2 * count):
        piece = pieces[k % count]
        begin = places[piece]
        end = begin + (sizes[piece] if k < count else 1)
        if k >= count and sizes[piece] == 1:
            continue
        votes = 0
        for m in range(len(a)):
            inside = begin <= places[b[m]] < end
            if inside != (begin <= places[a[m]] < end):
                sign = 1 if inside else -1
                near[votes] = sign * (offsets[m] + moves[a[m]] - moves[b[m]])
                agreeing[votes], against[votes] = weights[m], sign * order[m]
                votes += 1
        move = _best(near[:votes], agreeing[:votes], against[:votes], width)
        if move != 0:
            gained = True
            for member in pieces[begin:end]:
                moves[member] += move
    return gained


@numba.njit(cache=True)
def _best(near: Float64, weights: Float64, order: Float64, width: float) -> float:
    """Return the move with the least contradiction; 0 if it gains little, or touches less."""
    now, touching = 0.0, 0.0
    for m in range(len(near)):
        off = _off(near[m], width)
        now += (weights[m] + (abs(order[m]) if order[m] * near[m] < 0 else 0.0)) * off
        touching += weights[m] * (1 - off)
    least, best = now - _LEAST_GAIN, 0.0
    for k in range(0, len(near), len(near) // _TRIED + 1):
        total, touched = 0.0, 0.0
        for m in range(len(near)):
            away = near[k] - near[m]
            off = _off(away, width)
            total += (weights[m] + (abs(order[m]) if order[m] * away > 0 else 0.0)) * off
            touched += weights[m] * (1 - off)
            if total >= least:
                break
        if total < least and touched >= touching:
            least, best = total, near[k]
    return best
