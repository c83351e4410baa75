"""Whether a mesh is a surface everywhere, and its faces wind one way."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

Whole = npt.NDArray[np.int32]
Codes = npt.NDArray[np.int64]


class WoundAlike(NamedTuple):
    """Faces ``(F, 3)``; how many were turned round; edges that join more than two faces."""

    faces: Whole
    turned: int
    crowded: int


def wind_alike(faces: Whole) -> WoundAlike:
    """Turn faces round that wind against their neighbours.

    Normals blended over faces that wind both ways cancel out or point inwards. In each connected
    part the fewer faces are turned; across edges of more than two faces nothing is told.

    Parameters
    ----------
    faces
        ``(F, 3)`` vertex numbers. Faces that name a vertex twice do not count.

    Returns
    -------
    WoundAlike
        The faces in their order.
    """
    a, b, c = faces.T
    whole = np.flatnonzero((a != b) & (b != c) & (c != a))
    codes = _codes(faces[whole])
    ordered = np.sort(codes)
    edges = ordered >> 1
    third = edges[2:] == edges[:-2]
    # An edge of n faces is third n - 2 times in a row, and counts once.
    crowded = int(np.count_nonzero(third[1:] & ~third[:-1])) + int(third[:1].any())
    if not (ordered[1:] == ordered[:-1]).any():
        return WoundAlike(faces, 0, crowded)
    against = np.zeros(len(faces), np.bool_)
    against[whole] = _against(codes, faces[whole].sum(axis=1, dtype=np.int64))
    return WoundAlike(
        np.where(against[:, None], faces[:, ::-1], faces), int(against.sum()), crowded
    )


def _codes(faces: Whole) -> Codes:
    """Return ``(3 F,)`` numbers of half-edges: twice that of the edge, and its direction."""
    begin = faces.T.astype(np.int64)
    end = np.roll(begin, -1, axis=0)
    corners = int(faces.max(initial=0)) + 1
    edges = np.minimum(begin, end) * corners + np.maximum(begin, end)
    return (2 * edges + (begin > end)).ravel()


def _against(codes: Codes, totals: Codes) -> npt.NDArray[np.bool_]:
    """Return which faces, of these half-edges and sums of vertices, wind against their part."""
    count = len(totals)
    order = np.argsort(codes, kind="stable")
    edges = codes[order] >> 1
    same = np.concatenate([[False], edges[1:] == edges[:-1], [False]])
    pair = np.flatnonzero(same[1:-1] & ~same[:-2] & ~same[2:])
    first, second = order[pair], order[pair + 1]
    # Neighbours that wind alike run along their edge in opposite directions.
    unlike = codes[first] == codes[second]
    first, second = first % count, second % count
    # A face on its own copy is no neighbour of it: they share the third corner too.
    apart = totals[first] != totals[second]
    first, second, unlike = first[apart], second[apart], unlike[apart]
    # Every face twice, as it is and turned round: what belongs together hangs together.
    begin = np.concatenate([first, first + count])
    end = np.concatenate([second, second + count]) + count * np.concatenate([unlike, -1 * unlike])
    links = coo_array((np.ones(len(begin), np.int8), (begin, end)), shape=(2 * count, 2 * count))
    _, part = connected_components(links, directed=False)
    here, there = part[:count], part[count:]
    side = here > there
    name = np.minimum(here, there)
    fewer = 2 * np.bincount(name, side) > np.bincount(name)
    # A strip like Moebius' has one side only: nothing there winds against anything.
    against: npt.NDArray[np.bool_] = (side ^ fewer[name]) & (here != there)
    return against
