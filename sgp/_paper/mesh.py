"""What both mesh-based peers of the detail transfer stand on: umbrella weights, normals, bases."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import sparse

Vectors = npt.NDArray[np.float64]
Faces = npt.NDArray[np.int32]

# Variance per axis, in pixels, of one mean over the neighbours on a grid of triangles.
_STEP_VARIANCE = 2 / 3


def umbrella(faces: Faces, count: int) -> sparse.csr_array:
    """Return the ``(V, V)`` matrix that takes the mean over each vertex's neighbours.

    Parameters
    ----------
    faces
        ``(F, 3)``, all turning the same way: an edge inside then has one half-edge each way.
    count
        Number of vertices; one without a face is its own neighbour.
    """
    begin = faces.ravel()
    end = np.roll(faces, -1, axis=1).ravel()
    ones = np.ones(len(begin), np.float32)
    half = sparse.coo_array((ones, (begin, end)), shape=(count, count)).tocsr()
    both = sparse.csr_array(half + half.T)
    both.data[:] = 1
    degree = np.diff(both.indptr)
    alone = sparse.diags_array((degree == 0).astype(np.float64))
    return sparse.csr_array(sparse.diags_array(1.0 / np.maximum(degree, 1)) @ both + alone)


def base(mean: sparse.csr_array, vertices: Vectors, w: int) -> Vectors:
    """Return the smooth base: means over the neighbours until it is as smooth as the paper's shape.

    Parameters
    ----------
    mean
        See `umbrella`.
    vertices
        ``(V, k)``.
    w
        Of the paper's Gaussian, whose sigma is w / 2.
    """
    for _ in range(round((w / 2) ** 2 / _STEP_VARIANCE)):
        vertices = mean @ vertices
    return vertices


def vertex_normals(vertices: Vectors, faces: Faces) -> Vectors:
    """Return ``(V, 3)`` unit normals, area-weighted; a vertex without a face has z."""
    corners = vertices[faces]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    ends = np.arange(0, faces.size + 1, 3, dtype=np.int32)
    touch = sparse.csc_array(
        (np.ones(faces.size, np.float64), faces.ravel(), ends), shape=(len(vertices), len(faces))
    )
    total = np.asarray(touch @ crosses)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 0, total / np.where(length > 0, length, 1), (0.0, 0.0, 1.0))
