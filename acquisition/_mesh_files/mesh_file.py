"""What a mesh file holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, eq=False)
class MeshFile:
    """A triangle mesh or a point cloud as its file has it.

    Parameters
    ----------
    vertices
        ``(V, 3)`` float64; points that a scanner missed may be NaN.
    faces
        ``(F, 3)`` int64 vertex numbers, polygons cut into triangles; not checked against the
        vertices. None where the file has no surface.
    normals
        ``(V, 3)`` normals that came with the vertices, or None.
    warnings
        What was left out, a line each.
    """

    vertices: npt.NDArray[np.float64]
    faces: npt.NDArray[np.int64] | None = None
    normals: npt.NDArray[np.float64] | None = None
    warnings: tuple[str, ...] = ()
