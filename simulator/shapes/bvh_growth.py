"""Build a bounding volume hierarchy from the top down, with the binned surface area heuristic.

The method is that of Wald, On fast construction of SAH-based bounding volume hierarchies, 2007.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from rig.arrays import Float64, Int32
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

STACK = 96  # maximum number of waiting nodes in a traversal of any tree
_BINS = 16
_LEAF = 4
# From this depth on, ranges are halved, so that the stack is large enough for every tree.
_DEEP = 48


@numba.njit(**PART)
def _area(box: Float64) -> float:
    x, y, z = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    return float(x * y + y * z + z * x)


@numba.njit(**PART)
def _widen(box: Float64, low: Float64, high: Float64) -> None:
    for c in range(3):
        box[c] = min(box[c], low[c])
        box[c + 3] = max(box[c + 3], high[c])


@numba.njit(**PART)
def _best_split(
    low: Float64, high: Float64, order: Int32, start: int, stop: int, span: Float64
) -> tuple[int, int, float]:
    """Return axis, bin and cost of the cheapest split by the surface area heuristic."""
    best_axis, best_bin, best_cost = -1, 0, math.inf
    boxes, members = np.zeros((_BINS, 6)), np.zeros(_BINS, np.int64)
    above, above_count = np.zeros(_BINS), np.zeros(_BINS, np.int64)
    box = np.zeros(6)
    for c in range(3):
        width = span[c + 3] - span[c]
        if width <= 0.0:
            continue
        boxes[:, :3], boxes[:, 3:] = math.inf, -math.inf
        members[:] = 0
        for k in range(start, stop):
            f = order[k]
            middle = 0.5 * (low[f, c] + high[f, c])
            b = min(int((middle - span[c]) / width * _BINS), _BINS - 1)
            members[b] += 1
            _widen(boxes[b], low[f], high[f])
        box[:3], box[3:] = math.inf, -math.inf
        total = 0
        for b in range(_BINS - 1, 0, -1):
            if members[b]:
                _widen(box, boxes[b, :3], boxes[b, 3:])
                total += members[b]
            above_count[b] = total
            above[b] = _area(box) if total else 0.0
        box[:3], box[3:] = math.inf, -math.inf
        total = 0
        for b in range(_BINS - 1):
            if members[b]:
                _widen(box, boxes[b, :3], boxes[b, 3:])
                total += members[b]
            if total and above_count[b + 1]:
                cost = total * _area(box) + above_count[b + 1] * above[b + 1]
                if cost < best_cost:
                    best_axis, best_bin, best_cost = c, b, cost
    return best_axis, best_bin, best_cost


@numba.njit(cache=True)
def grow(
    low: Float64,
    high: Float64,
    order: Int32,
    bounds: Float64,
    first: Int32,
    count: Int32,
    axis: Int32,
) -> int:
    """Fill the node arrays depth first and return the number of nodes."""
    todo = np.zeros((STACK, 4), np.int64)  # start, stop, parent if a right child, depth
    todo[0, 1], todo[0, 2] = len(order), -1
    waiting, node = 1, 0
    span = np.zeros(6)
    while waiting:
        waiting -= 1
        start, stop, parent, depth = todo[waiting]
        here, node = node, node + 1
        if parent >= 0:
            first[parent] = here
        bounds[here, :3], bounds[here, 3:] = math.inf, -math.inf
        span[:3], span[3:] = math.inf, -math.inf
        for k in range(start, stop):
            f = order[k]
            _widen(bounds[here], low[f], high[f])
            middle = 0.5 * (low[f] + high[f])
            _widen(span, middle, middle)
        size = stop - start
        if size == 1:
            first[here], count[here] = start, size
            continue
        cut, split_axis = start, 0
        if depth < _DEEP:
            chosen, at, cost = _best_split(low, high, order, start, stop, span)
            # One more box to test costs about as much as one more triangle.
            if size <= _LEAF and cost >= (size - 1) * _area(bounds[here]):
                first[here], count[here] = start, size
                continue
            if chosen >= 0:
                split_axis = chosen
                width = span[chosen + 3] - span[chosen]
                for k in range(start, stop):
                    f = order[k]
                    middle = 0.5 * (low[f, chosen] + high[f, chosen])
                    if min(int((middle - span[chosen]) / width * _BINS), _BINS - 1) <= at:
                        order[k], order[cut] = order[cut], f
                        cut += 1
        if cut in (start, stop):
            cut = (start + stop) // 2
        axis[here] = split_axis
        todo[waiting, 0], todo[waiting, 1], todo[waiting, 2] = cut, stop, here
        todo[waiting + 1, 0], todo[waiting + 1, 1], todo[waiting + 1, 2] = start, cut, -1
        todo[waiting, 3] = todo[waiting + 1, 3] = depth + 1
        waiting += 2
    return node
