"""Consistent winding of the faces of a mesh, and detection of non-manifold edges."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from processing._projection.mesh_kernels import edge_faults, half_edges

Whole = npt.NDArray[np.int32]
Codes = npt.NDArray[np.int64]


class WoundAlike(NamedTuple):
    """Faces ``(F, 3)``, the number of reversed faces, and of edges with more than two faces."""

    faces: Whole
    turned: int
    crowded: int


def wind_alike(faces: Whole) -> WoundAlike:
    """Reverse faces whose winding is opposite to that of their neighbours.

    Normals that are blended over faces of opposite winding cancel out or point inwards. In each
    connected part the minority is reversed. Edges with more than two faces connect no faces.

    Parameters
    ----------
    faces
        ``(F, 3)`` vertex indices. Faces that contain a vertex twice do not count.

    Returns
    -------
    WoundAlike
        The faces in their original order.
    """
    a, b, c = faces.T
    crowded, unlike = edge_faults(np.ascontiguousarray(faces, np.int32))
    if not unlike:
        return WoundAlike(faces, 0, crowded)
    whole = np.flatnonzero((a != b) & (b != c) & (c != a))
    against = np.zeros(len(faces), np.bool_)
    against[whole] = _against(half_edges(faces[whole])[0], faces[whole].sum(axis=1, dtype=np.int64))
    return WoundAlike(
        np.where(against[:, None], faces[:, ::-1], faces), int(against.sum()), crowded
    )


def first_of_twins(faces: Whole) -> npt.NDArray[np.bool_]:
    """Return the mask of the faces that do not repeat an earlier one, in either winding."""
    a, b, c = np.sort(faces, axis=1).T
    order = np.lexsort((c, b, a))  # stable: the first of equal faces remains first
    same = np.zeros(len(faces), np.bool_)
    same[1:] = (np.diff(np.stack([a, b, c])[:, order]) == 0).all(axis=0)
    first = np.ones(len(faces), np.bool_)
    first[order[same]] = False
    return first


def neighbours(codes: Codes) -> tuple[Codes, Codes]:
    """Return the places in `codes` of the pairs of half-edges on edges that have two faces."""
    order = np.argsort(codes, kind="stable")
    edges = codes[order] >> 1
    same = np.concatenate([[False], edges[1:] == edges[:-1], [False]])
    pair = np.flatnonzero(same[1:-1] & ~same[:-2] & ~same[2:])
    return order[pair], order[pair + 1]


def _against(codes: Codes, totals: Codes) -> npt.NDArray[np.bool_]:
    """Return the faces whose winding is opposite to that of the majority of their part.

    Parameters
    ----------
    codes
        ``(3 F,)`` codes of half-edges from `half_edges`.
    totals
        ``(F,)`` sums of the vertex indices of each face.
    """
    count = len(totals)
    first, second = neighbours(codes)
    # Neighbours with the same winding traverse their common edge in opposite directions.
    unlike = codes[first] == codes[second]
    first, second = first % count, second % count
    # Duplicate faces also share the third corner and are not neighbours.
    apart = totals[first] != totals[second]
    first, second, unlike = first[apart], second[apart], unlike[apart]
    # The graph contains every face twice, in its own and in reversed orientation, and connects
    # neighbours of consistent orientation.
    begin = np.concatenate([first, first + count])
    end = np.concatenate([second, second + count]) + count * np.concatenate([unlike, -1 * unlike])
    links = coo_array((np.ones(len(begin), np.int8), (begin, end)), shape=(2 * count, 2 * count))
    _, part = connected_components(links, directed=False)
    here, there = part[:count], part[count:]
    side = here > there
    name = np.minimum(here, there)
    fewer = 2 * np.bincount(name, side) > np.bincount(name)
    # A Moebius strip has only one side, so no orientation is wrong.
    return np.asarray((side ^ fewer[name]) & (here != there))
