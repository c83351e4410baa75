"""Kernels that compare the vertices and the edges of a mesh, in time proportional to its size."""

from __future__ import annotations

import numba
import numpy as np

from rig.arrays import Bool, Float64, Int32, Int64, UInt64
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

# Odd constants of which all bits are mixed (Steele et al., SplitMix64, 2014).
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


def joined_vertices(vertices: Float64, used: Bool) -> tuple[Int64, Int32]:
    """Give used vertices numbers; those with equal coordinates have the same number.

    Parameters
    ----------
    vertices
        ``(V, 3)`` finite.
    used
        ``(V,)`` bool.

    Returns
    -------
    tuple
        Indices of the first vertex at each position, ascending, and ``(V,)`` numbers, 0 for the
        others.
    """
    size = 1 << max(4, (2 * int(np.count_nonzero(used))).bit_length())
    positive = np.ascontiguousarray(vertices + 0.0)  # -0.0 becomes 0.0, to which it is equal
    kept, number = _joined_vertices(positive.view(np.uint64), used, size)
    return np.asarray(kept, np.int64), np.asarray(number, np.int32)


@numba.njit(**PART)
def _mixed(value: np.uint64) -> np.uint64:
    once = (value ^ (value >> np.uint64(30))) * _MIX_1
    twice = (once ^ (once >> np.uint64(27))) * _MIX_2
    return twice ^ (twice >> np.uint64(31))


@numba.njit(cache=True)
def _joined_vertices(bits: UInt64, used: Bool, size: int) -> tuple[Int64, Int32]:
    # A hash table with open addressing, at most half full, of 1 + the number of a position.
    table = np.zeros(size, np.int32)
    last = np.uint64(size - 1)
    kept = np.zeros(len(bits), np.int64)
    number = np.zeros(len(bits), np.int32)
    count = 0
    for v in range(len(bits)):
        if not used[v]:
            continue
        place = _mixed(bits[v, 0])
        place = _mixed(place ^ bits[v, 1])
        place = _mixed(place ^ bits[v, 2]) & last
        while True:
            found = table[place]
            if found == 0:
                table[place] = count + 1
                kept[count] = v
                number[v] = count
                count += 1
                break
            w = kept[found - 1]
            if bits[w, 0] == bits[v, 0] and bits[w, 1] == bits[v, 1] and bits[w, 2] == bits[v, 2]:
                number[v] = found - 1
                break
            place = (place + np.uint64(1)) & last
    return kept[:count].copy(), number


def edge_faults(faces: Int32) -> tuple[int, bool]:
    """Return how many edges have more than two faces, and whether two faces run along one alike.

    Neighbours with the same winding traverse their common edge in opposite directions.

    Parameters
    ----------
    faces
        ``(F, 3)`` vertex indices; faces that contain a vertex twice do not count.
    """
    crowded, unlike = _edge_faults(faces, int(faces.max(initial=-1)) + 1)
    return int(crowded), bool(unlike)


@numba.njit(cache=True)
def _edge_faults(faces: Int32, vertices: int) -> tuple[int, bool]:
    # The half-edges of each vertex that is the lower end: 2 * the other end + the direction.
    begin = np.zeros(vertices + 1, np.int64)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if a != b and b != c and c != a:
            begin[min(a, b) + 1] += 1
            begin[min(b, c) + 1] += 1
            begin[min(c, a) + 1] += 1
    for v in range(vertices):
        begin[v + 1] += begin[v]
    free = begin[:-1].copy()
    codes = np.zeros(begin[-1], np.int64)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if a != b and b != c and c != a:
            for p, q in ((a, b), (b, c), (c, a)):
                low, high = min(p, q), max(p, q)
                codes[free[low]] = 2 * np.int64(high) + (1 if p > q else 0)
                free[low] += 1
    crowded, unlike = 0, False
    for v in range(vertices):
        part = codes[begin[v] : begin[v + 1]]
        if len(part) < 2:
            continue
        _sort(part)
        run = 1
        for i in range(1, len(part)):
            unlike |= part[i] == part[i - 1]
            run = run + 1 if part[i] >> 1 == part[i - 1] >> 1 else 1
            crowded += 1 if run == 3 else 0
    return crowded, unlike


def half_edges(faces: Int32, every: int = 1) -> tuple[Int64, Int64]:
    """Return the codes and the places of the half-edges, or of those of every so many vertices.

    An edge belongs to its lower vertex. The code of a half-edge is twice the number of its edge +
    its direction; half-edge `h` belongs to face ``h % F`` and begins at its corner ``h // F``.
    """
    whole = np.ascontiguousarray(faces, np.int32)
    codes, places = _half_edges(whole, every, int(faces.max(initial=-1)) + 1)
    return codes, places


@numba.njit(cache=True)
def _half_edges(faces: Int32, every: int, vertices: int) -> tuple[Int64, Int64]:
    count = len(faces)
    codes, places = np.zeros(0, np.int64), np.zeros(0, np.int64)
    found = 0
    for fill in (False, True):
        if fill:
            codes, places = np.zeros(found, np.int64), np.zeros(found, np.int64)
        found = 0
        for corner in range(3):
            for f in range(count):
                p, q = faces[f, corner], faces[f, (corner + 1) % 3]
                low, high = min(p, q), max(p, q)
                if low % every == 0:
                    if fill:
                        edge = np.int64(low) * vertices + high
                        codes[found] = 2 * edge + (1 if p > q else 0)
                        places[found] = corner * count + f
                    found += 1
    return codes, places


@numba.njit(**PART)
def _sort(values: Int64) -> None:
    """Sort a few values in place; many by the library."""
    if len(values) > 32:
        values.sort()
        return
    for i in range(1, len(values)):
        value = values[i]
        j = i
        while j > 0 and values[j - 1] > value:
            values[j] = values[j - 1]
            j -= 1
        values[j] = value
