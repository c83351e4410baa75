"""Compiled loops over squares of four pixels that become triangles."""

from __future__ import annotations

import numba
import numpy as np

from rig.arrays import Bool, Float32, Int32, Int64, UInt8
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

# Kinds of triangles, by the corners of a square, a and b above d and e: a d b, b d e, a d e, a e b.
KINDS = 4


def faces_of(
    parts: Int32, vertices: Float32, cut_right: Bool | None = None, cut_down: Bool | None = None
) -> Int32:
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
    kinds, inside = kinds_of_triangles(parts, vertices, cut_right, cut_down), parts >= 0
    return np.concatenate([faces_of_kind(kinds, inside, kind) for kind in range(KINDS)])


def kinds_of_triangles(
    parts: Int32, vertices: Float32, cut_right: Bool | None = None, cut_down: Bool | None = None
) -> UInt8:
    """Return the kinds of triangles of each square ``(H, W)``: bit 0 for a d b, and so on.

    The parameters are those of `faces_of`. The pixel of a square is its upper left one.
    """
    right = np.zeros(parts.shape, bool) if cut_right is None else np.ascontiguousarray(cut_right)
    down = np.zeros(parts.shape, bool) if cut_down is None else np.ascontiguousarray(cut_down)
    return _kinds(parts, right, down, vertices)


def faces_of_kind(kinds: UInt8, inside: Bool, kind: int, first: int = 0) -> Int32:
    """Return the triangles of one kind in reading order; those of the last row need a next one.

    Parameters
    ----------
    kinds
        ``(H, W)`` kinds of each square.
    inside
        ``(H, W)`` bool, the pixels that are vertices.
    kind
        Number of the kind.
    first
        Number of the first vertex.
    """
    faces = np.zeros((np.count_nonzero(kinds[:-1] & (1 << kind)), 3), np.int32)
    per_row = np.count_nonzero(inside, axis=1)
    _fill(kinds, inside, first + np.cumsum(per_row) - per_row, kind, faces)
    return faces


@numba.njit(**PART)
def _distance2(vertices: Float32, one: int, other: int) -> np.float32:
    x = vertices[one, 0] - vertices[other, 0]
    y = vertices[one, 1] - vertices[other, 1]
    z = vertices[one, 2] - vertices[other, 2]
    return np.float32(x * x + y * y + z * z)


@numba.njit(**PART)
def _square(
    parts: Int32, right: Bool, down: Bool, vertices: Float32, r: int, c: int, above: int, below: int
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
def _kinds(parts: Int32, right: Bool, down: Bool, vertices: Float32) -> UInt8:
    rows, columns = parts.shape
    kinds = np.zeros((rows, columns), np.uint8)
    above = 0
    for r in range(rows - 1):
        below = above + int(np.count_nonzero(parts[r] >= 0))
        start = below
        for c in range(columns - 1):
            adb, bde, ade, aeb = _square(parts, right, down, vertices, r, c, above, below)
            kinds[r, c] = adb + 2 * bde + 4 * ade + 8 * aeb
            above += parts[r, c] >= 0
            below += parts[r + 1, c] >= 0
        above = start
    return kinds


@numba.njit(cache=True)
def _fill(kinds: UInt8, inside: Bool, first: Int64, kind: int, faces: Int32) -> None:
    """Write the triangles of a kind; ``first`` is the number of the first vertex of each row."""
    rows, columns = kinds.shape
    place = 0
    for r in range(rows - 1):
        a, d = first[r], first[r + 1]
        for c in range(columns - 1):
            b, e = a + inside[r, c], d + inside[r + 1, c]
            if kinds[r, c] >> kind & 1:
                faces[place, 0] = b if kind == 1 else a
                faces[place, 1] = e if kind == 3 else d
                faces[place, 2] = b if kind == 0 or kind == 3 else e
                place += 1
            a, d = b, e
