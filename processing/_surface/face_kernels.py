"""Compiled loops over squares of four pixels that become triangles."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float32]
Ints = npt.NDArray[np.int32]
Counts = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

# A triangle of each kind, by the corners of a square: a and b above d and e.
_KINDS = 4  # a d b, b d e, a d e, a e b


def faces_of(
    parts: Ints, vertices: Float, cut_right: Mask | None = None, cut_down: Mask | None = None
) -> Ints:
    """Return the triangles of a surface.

    Parameters
    ----------
    parts
        ``(H, W)`` int32 part of each pixel, -1 outside.
    vertices
        ``(V, 3)`` float32, the points of the pixels inside, in reading order.
    cut_right, cut_down
        ``(H, W)`` bool: no triangle has both the pixel and its right (lower) neighbour as corners.

    Returns
    -------
    Ints
        ``(F, 3)`` int32 vertex indices, counter-clockwise as seen from the camera. First all
        triangles a d b in reading order, then b d e, a d e and a e b. A square of four pixels of
        one part is split along its shorter diagonal, b d if both are equal.
    """
    return faces_by_kind(parts, vertices, cut_right, cut_down)[0]


def faces_by_kind(
    parts: Ints, vertices: Float, cut_right: Mask | None = None, cut_down: Mask | None = None
) -> tuple[Ints, Counts]:
    """Return what `faces_of` returns, and the ``(4,)`` numbers of triangles of each kind."""
    right = np.zeros(parts.shape, bool) if cut_right is None else np.ascontiguousarray(cut_right)
    down = np.zeros(parts.shape, bool) if cut_down is None else np.ascontiguousarray(cut_down)
    per_row = np.count_nonzero(parts >= 0, axis=1)
    first = np.concatenate([[0], np.cumsum(per_row)])
    counts = _counted(parts, right, down, vertices, first)
    ends = np.cumsum(counts.T.ravel())
    begins = np.ascontiguousarray((ends - counts.T.ravel()).reshape(_KINDS, -1).T)
    faces = np.zeros((int(ends[-1]) if len(ends) else 0, 3), np.int32)
    _filled(parts, right, down, vertices, first, begins, faces)
    return faces, counts.sum(axis=0)


@numba.njit(cache=True)
def _distance2(vertices: Float, one: int, other: int) -> np.float32:
    x = vertices[one, 0] - vertices[other, 0]
    y = vertices[one, 1] - vertices[other, 1]
    z = vertices[one, 2] - vertices[other, 2]
    return np.float32(x * x + y * y + z * z)


@numba.njit(cache=True)
def _square(
    parts: Ints, right: Mask, down: Mask, vertices: Float, r: int, c: int, above: int, below: int
) -> tuple[bool, bool, bool, bool]:
    """Return which triangles the square has whose pixel a is (r, c).

    ``above`` and ``below`` are the vertices of a and d, or of the next pixels inside.
    """
    a, b, d, e = parts[r, c], parts[r, c + 1], parts[r + 1, c], parts[r + 1, c + 1]
    adb = a >= 0 and d == a and b == a
    bde = b >= 0 and d == b and e == b
    ade = a >= 0 and d == a and e == a
    aeb = a >= 0 and e == a and b == a
    if adb and bde:
        # All four are inside, so b follows a and e follows d.
        across = _distance2(vertices, above, below + 1)
        adb = bde = _distance2(vertices, above + 1, below) <= across
        ade = aeb = not adb
    ab, de, ad, be = right[r, c], right[r + 1, c], down[r, c], down[r, c + 1]
    return (
        adb and not (ab or ad),
        bde and not (be or de),
        ade and not (ad or de),
        aeb and not (ab or be),
    )


@numba.njit(cache=True)
def _counted(parts: Ints, right: Mask, down: Mask, vertices: Float, first: Counts) -> Counts:
    """Return the number of triangles of each row of squares and each kind."""
    rows, columns = parts.shape
    counts = np.zeros((max(rows - 1, 0), _KINDS), np.int64)
    for r in range(rows - 1):
        above, below = first[r], first[r + 1]
        for c in range(columns - 1):
            adb, bde, ade, aeb = _square(parts, right, down, vertices, r, c, above, below)
            counts[r, 0] += adb
            counts[r, 1] += bde
            counts[r, 2] += ade
            counts[r, 3] += aeb
            above += parts[r, c] >= 0
            below += parts[r + 1, c] >= 0
    return counts


@numba.njit(cache=True)
def _put(faces: Ints, place: int, one: int, two: int, three: int) -> None:
    faces[place, 0], faces[place, 1], faces[place, 2] = one, two, three


@numba.njit(cache=True)
def _filled(
    parts: Ints,
    right: Mask,
    down: Mask,
    vertices: Float,
    first: Counts,
    begins: Counts,
    faces: Ints,
) -> None:
    """Write the triangles; those of a row of squares and a kind begin at ``begins``."""
    rows, columns = parts.shape
    for r in range(rows - 1):
        above, below = first[r], first[r + 1]
        i, j, k, m = begins[r, 0], begins[r, 1], begins[r, 2], begins[r, 3]
        for c in range(columns - 1):
            adb, bde, ade, aeb = _square(parts, right, down, vertices, r, c, above, below)
            b = above + (parts[r, c] >= 0)
            e = below + (parts[r + 1, c] >= 0)
            if adb:
                _put(faces, i, above, below, b)
                i += 1
            if bde:
                _put(faces, j, b, below, e)
                j += 1
            if ade:
                _put(faces, k, above, below, e)
                k += 1
            if aeb:
                _put(faces, m, above, e, b)
                m += 1
            above, below = b, e
