"""Sharp edges of parts: where the normals of a mesh are not blended, and normals of the file."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from processing._projection.manifold import half_edges, neighbours

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int32]

# The usual crease angle. Another one is chosen if the edges of a part leave no gap around it.
_USUAL_DEG: Final = 40
_LEAST_DEG, _MOST_DEG = 32, 60
# Half the width of a gap: the edges of a cylinder of 24 segments turn by 15 degrees.
_GAP_DEG: Final = 8
# Edges in the gap, relative to the sharper ones: the edges of scanned and of decimated meshes
# have all angles, ever fewer of the larger ones; there it is .5 and more.
_MOST_BETWEEN: Final = 0.05
# Share of all edges, by length: a few folded faces do not make a part.
_LEAST_SHARP: Final = 1e-3
# The normal of a face that is longer than this many times its width is uncertain.
_LONGEST: Final = 1e3
# Edges that are enough to judge a mesh.
_ENOUGH: Final = 1_000_000
# Angles to normals of the file that rounding and the coarseness of a mesh explain.
_ROUNDING_DEG: Final = 0.5


def crease_angle_deg(vertices: Double, faces: Whole) -> float | None:
    """Return the angle that separates sharp edges from others; None if there is no such angle.

    The edges of a part with hard edges turn either by little, within its smooth faces, or by much.
    Those of a scan turn by all angles, so that no edge can be called sharp.

    Parameters
    ----------
    vertices
        ``(V, 3)``.
    faces
        ``(F, 3)`` faces that have an area.
    """
    every = max(3 * len(faces) // _ENOUGH, 1)
    first, second, edges = neighbours(half_edges(faces), every)
    angle, _, sound = _angles(vertices, faces, first, second)
    a, b = edges // (int(faces.max()) + 1), edges % (int(faces.max()) + 1)
    length = np.linalg.norm(vertices[a] - vertices[b], axis=1) * sound
    for centre in sorted(range(_LEAST_DEG, _MOST_DEG + 1), key=lambda deg: abs(deg - _USUAL_DEG)):
        above = length[angle >= centre + _GAP_DEG].sum()
        between = length[np.abs(angle - centre) < _GAP_DEG].sum()
        if above > _LEAST_SHARP * length.sum() and between <= _MOST_BETWEEN * above:
            return float(centre)
    return None


def corners_at_creases(vertices: Double, faces: Whole, crease_deg: float) -> tuple[Whole, int]:
    """Return numbers of normals for the corners of faces; equal ones share a normal.

    Returns
    -------
    tuple
        ``(F, 3)`` numbers from 0, and the number of sharp edges. Faces on both sides of an edge
        share the normals at its ends if they turn by less than the crease angle.
    """
    first, second, _ = neighbours(half_edges(faces), 1)
    angle, alike, _ = _angles(vertices, faces, first, second)
    smooth = angle < crease_deg
    count = len(faces)
    one, two, alike = first[smooth], second[smooth], alike[smooth]
    # The half-edge h of a face begins at the corner h and ends at the next one.
    one_end, two_end = (one + count) % (3 * count), (two + count) % (3 * count)
    begin = np.concatenate([one, one_end])
    end = np.concatenate([np.where(alike, two, two_end), np.where(alike, two_end, two)])
    links = coo_array((np.ones(len(begin), np.int8), (begin, end)), shape=(3 * count, 3 * count))
    _, part = connected_components(links, directed=False)
    return (
        np.ascontiguousarray(part.reshape(3, count).T, np.int32),
        int(np.count_nonzero(~smooth)),
    )


def _angles(
    vertices: Double, faces: Whole, first: npt.NDArray[np.int64], second: npt.NDArray[np.int64]
) -> tuple[Double, npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Return by how many degrees neighbours turn, which run alike, and which normals are sound."""
    normal, wide = _face_normals(vertices, faces)
    f, g = first % len(faces), second % len(faces)
    alike = faces.T.ravel()[first] == faces.T.ravel()[second]
    other = np.where(alike[:, None], -normal[g], normal[g])
    angle = np.degrees(_angle(normal[f], other))
    return angle, alike, wide[f] & wide[g]


def _face_normals(vertices: Double, faces: Whole) -> tuple[Double, npt.NDArray[np.bool_]]:
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    cross = np.cross(b - a, c - a)
    longest = np.max([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    area = np.linalg.norm(cross, axis=1)
    return cross / np.maximum(area, 1e-300)[:, None], area * _LONGEST > longest


def _angle(a: npt.NDArray[np.floating], b: npt.NDArray[np.floating]) -> Double:
    crossed = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.asarray(np.arctan2(crossed, (a * b).sum(axis=-1)), np.float64)


def blended_with_given(
    given: npt.NDArray[np.floating], blended: Float, vertices: Double, faces: Whole
) -> tuple[Float, float]:
    """Return the normals of the file where they fit the faces, else blended ones.

    Parameters
    ----------
    given
        ``(F, 3, 3)`` normals of corners in the file, unit vectors of either sign or NaN.
    blended
        ``(F, 3, 3)`` normals that are blended over the faces.
    vertices, faces
        ``(V, 3)`` and ``(F, 3)``.

    Returns
    -------
    tuple
        ``(F, 3, 3)`` normals; the median angle in degrees by which those of the file differ from
        the blended ones if it is too large for them to be used, else 0.
    """
    normal, _ = _face_normals(vertices, faces)
    face = np.repeat(normal[:, None], 3, axis=1)
    given = np.where((given * face).sum(axis=-1, keepdims=True) < 0, -given, given)
    known = np.isfinite(given).all(axis=-1)
    if not known.any():
        return blended, 0.0
    off = math.degrees(float(np.median(_angle(given[known], blended[known]))))
    coarse = math.degrees(float(np.median(_angle(blended[known], face[known]))))
    # Normals of the true surface are far nearer to the blended ones than those of the faces are.
    if off > 0.5 * coarse + _ROUNDING_DEG:
        return blended, off
    close = np.asarray((np.where(known[..., None], given, 0) * face).sum(axis=-1) > 0.5)
    near = known & close
    return np.where(near[..., None], given, blended).astype(np.float32), 0.0
