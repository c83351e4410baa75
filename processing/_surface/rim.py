"""The rim of a triangle mesh."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from acquisition import DataError

Ints = npt.NDArray[np.int32]
Edges = npt.NDArray[np.int64]


def rim(faces: Ints, count: int) -> Edges:
    """Return the edges with a triangle on one side only, ``(E, 2)``, in its direction.

    Raises
    ------
    DataError
        If two triangles have an edge in the same direction.
    """
    codes = np.sort(_codes(faces, count))
    if (codes[1:] == codes[:-1]).any():
        raise DataError("an edge of the mesh belongs to more than two triangles")
    backward = np.sort(codes % count * count + codes // count)
    places = np.searchsorted(backward, codes).clip(max=len(codes) - 1)
    open_ = codes[backward[places] != codes]
    return np.stack([open_ // count, open_ % count], axis=1)


def _codes(faces: Ints, count: int) -> Edges:
    """Return each edge of each triangle as one number."""
    corners = faces.astype(np.int64)
    return (corners * count + np.roll(corners, -1, axis=1)).ravel()
