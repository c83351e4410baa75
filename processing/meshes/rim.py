"""The rim of a triangle mesh."""

from __future__ import annotations

import numpy as np

from acquisition import DataError
from rig.arrays import Int32, Int64


def rim(faces: Int32, count: int) -> Int64:
    """Return the edges with a triangle on one side only, ``(E, 2)``, in its direction.

    Raises
    ------
    DataError
        If two triangles have an edge in the same direction.
    """
    # Twice the number of an edge, the smaller end first; 1 is added if it runs to the smaller end.
    sides = np.zeros((3, len(faces)), np.int64)
    for side, code in enumerate(sides):
        start, end = faces[:, side], faces[:, (side + 1) % 3]
        np.multiply(np.minimum(start, end), 2 * count, out=code, dtype=np.int64)
        code += 2 * np.maximum(start, end)
        code += start > end
    codes = sides.ravel()
    codes.sort()
    if (codes[1:] == codes[:-1]).any():
        raise DataError("an edge of the mesh belongs to more than two triangles")
    # The two directions of an edge follow each other.
    there = np.flatnonzero((codes[1:] == codes[:-1] + 1) & (codes[1:] % 2 == 1))
    alone = np.ones(len(codes), bool)
    alone[there] = alone[there + 1] = False
    codes, backward = np.divmod(codes[alone], 2)
    ends = np.stack([codes // count, codes % count], axis=1)
    ends[backward == 1] = ends[backward == 1, ::-1]
    # A triangle without an area may have the same corner twice.
    directed: Int64 = ends[ends[:, 0] != ends[:, 1]]
    return directed
