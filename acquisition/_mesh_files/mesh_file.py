"""Content of a mesh file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from rig import Notice, short_repr


@dataclass(frozen=True, eq=False)
class MeshFile:
    """A triangle mesh or a point cloud, unchanged from its file.

    Parameters
    ----------
    vertices
        ``(V, 3)`` float64; points that a scanner missed may be NaN.
    faces
        ``(F, 3)`` int64 vertex indices; polygons are split into triangles. They are not checked
        against the number of vertices. None if the file has no surface.
    normals
        ``(V, 3)`` normals of the vertices as they are in the file, NaN for vertices without
        one; None if the file has no normals. A vertex with several normals is there several times.
    warnings
        One notice for each kind of data that was left out, or read in a way that others may not
        expect.
    """

    vertices: npt.NDArray[np.float64]
    faces: npt.NDArray[np.int64] | None = None
    normals: npt.NDArray[np.float64] | None = None
    warnings: tuple[Notice, ...] = ()

    __repr__ = short_repr
