"""Polygons of mesh files, split into triangles."""

from __future__ import annotations

from typing import Final

import numba
import numpy as np

from rig import Notice, UnreadableError, pluralize
from rig.arrays import Bool, Float64, Int64
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

# Comparisons of corners that all polygons that are not convex may take together: about 2 s.
_MOST_STEPS: Final = 1_000_000_000
# A triangle of a fan points the other way if its area does by more than rounding.
_ROUNDING: Final = 1e-9


def triangles_of(
    lengths: Int64, corners: Int64, vertices: Float64
) -> tuple[Int64, tuple[Notice, ...]]:
    """Split polygons into triangles: into fans if they are convex, else by cutting off ears.

    Parameters
    ----------
    lengths
        ``(P,)`` numbers of corners.
    corners
        Concatenated vertex indices of all polygons; they are not checked.
    vertices
        ``(V, 3)``.

    Returns
    -------
    tuple
        ``(T, 3)`` vertex indices in the order of the polygons, and notices about polygons that
        have too few corners or intersect themselves.

    Raises
    ------
    UnreadableError
        If polygons that are not convex have too many corners.

    Notes
    -----
    G. H. Meisters, Polygons have ears, American Mathematical Monthly 82 (1975).
    """
    few = int(np.count_nonzero(lengths < 3))
    notices = []
    if few:
        words = (
            "face with fewer than three corners was",
            "faces with fewer than three corners were",
        )
        notices.append(Notice("faces-with-few-corners", f"{pluralize(few, *words)} left out"))
    if (lengths == 3).all():
        return corners.reshape(-1, 3), ()
    begins = np.cumsum(lengths) - lengths
    cut = np.maximum(lengths - 2, 0)
    polygon = np.repeat(np.arange(len(lengths)), cut)
    step = np.arange(len(polygon)) - np.repeat(np.cumsum(cut) - cut, cut)
    first = begins[polygon]
    places = np.stack([first, first + step + 1, first + step + 2], axis=1)
    if len(corners) and corners.min() >= 0 and corners.max() < len(vertices):
        crossed = _cut_ears(places, polygon, lengths, begins, vertices[corners])
        if crossed:
            words = ("polygon intersects itself", "polygons intersect themselves")
            text = f"{pluralize(crossed, *words)} and may be drawn too large"
            notices.append(Notice("polygons-crossed", f"{text}: save the mesh with triangles"))
    return corners[places], tuple(notices)


def _cut_ears(places: Int64, polygon: Int64, lengths: Int64, begins: Int64, points: Float64) -> int:
    """Replace fans of polygons that are not convex; return how many could not be split."""
    a, b, c = (points[places[:, corner]] for corner in range(3))
    with np.errstate(all="ignore"):  # coordinates are checked later
        areas = np.cross(b - a, c - a)
        total = np.stack([np.bincount(polygon, axis, len(lengths)) for axis in areas.T], axis=1)
        size2 = (total**2).sum(axis=1)
        against = (areas * total[polygon]).sum(axis=1) < -_ROUNDING * size2[polygon]
    concave = np.flatnonzero(np.bincount(polygon[against], minlength=len(lengths)))
    if not len(concave):
        return 0
    # The coordinates in the plane of each polygon, which runs counter-clockwise in them.
    normal = total[concave] / np.sqrt(size2[concave])[:, None]
    u = np.cross(normal, np.eye(3)[np.abs(normal).argmin(axis=1)])
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(normal, u)
    count = lengths[concave]
    owner = np.repeat(np.arange(len(concave)), count)
    ends = np.cumsum(count)
    own = np.arange(ends[-1]) + np.repeat(begins[concave] - (ends - count), count)
    flat = points[own] - points[begins[concave]][owner]
    x, y = (flat * u[owner]).sum(axis=1), (flat * v[owner]).sum(axis=1)
    ears = np.full((int((count - 2).sum()), 3), -1, np.int64)
    crossed, steps = _ears(x, y, ends - count, count, ears, _MOST_STEPS)
    if steps < 0:
        raise UnreadableError(
            f"polygons that are not convex have up to {count.max()} corners, which are too many: "
            "save the mesh with triangles"
        )
    rows = np.flatnonzero(np.isin(polygon, concave))
    # A polygon that could not be split keeps its fan; corners on a line leave no triangle.
    failed = np.repeat(crossed, count - 2)
    shift = np.repeat(begins[concave], count - 2)[:, None]
    gone = ears[:, :1] < 0
    # An ear that is missing repeats a corner, so it has no area, like the corners on a line.
    places[rows[~failed]] = (np.where(gone, 0, ears) + shift)[~failed]
    return int(crossed.sum())


@numba.njit(**PART)
def _turn(x: Float64, y: Float64, a: int, b: int, c: int) -> float:
    turn: float = (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])
    return turn


@numba.njit(cache=True)
def _ears(
    x: Float64, y: Float64, begins: Int64, lengths: Int64, ears: Int64, steps: int
) -> tuple[Bool, int]:
    """Cut off ears; return which polygons have none left, and the remaining steps."""
    crossed = np.zeros(len(lengths), np.bool_)
    row = 0
    for p in range(len(lengths)):
        begin, count = begins[p], lengths[p]
        after, before = np.arange(1, count + 1), np.arange(-1, count - 1)
        after[count - 1], before[0] = 0, count - 1
        left, i, idle, at = count, 0, 0, row
        while left > 2:
            a, b, c = begin + before[i], begin + i, begin + after[i]
            turn = _turn(x, y, a, b, c)
            # Corners on a line are cut off if no other ear is left.
            ear = turn > 0 or (idle > left and turn == 0)
            if turn > 0:
                j = after[after[i]]
                while ear and j != before[i]:
                    steps -= 1
                    q = begin + j
                    same = (
                        (x[q] == x[a] and y[q] == y[a])
                        or (x[q] == x[b] and y[q] == y[b])
                        or (x[q] == x[c] and y[q] == y[c])
                    )
                    ear = same or not (
                        _turn(x, y, a, b, q) >= 0
                        and _turn(x, y, b, c, q) >= 0
                        and _turn(x, y, c, a, q) >= 0
                    )
                    j = after[j]
            if steps < 0:
                return crossed, steps
            if ear:
                if turn > 0:
                    ears[at, 0], ears[at, 1], ears[at, 2] = before[i], i, after[i]
                    at += 1
                after[before[i]], before[after[i]] = after[i], before[i]
                left -= 1
                idle = 0
            else:
                idle += 1
            i = after[i]
            if idle > 2 * left:
                crossed[p] = True
                break
        row += count - 2
    return crossed, steps
