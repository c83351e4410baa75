"""Smooth bases and vertex normals, for both mesh-based peers of the detail transfer.

The peers receive more than a mesh method usually has: one vertex per pixel. The smooth base is
therefore the paper's Gaussian, applied to positions instead of normals, and needs no sparse matrix.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numba
import numpy as np

from processing.surface.grid_graph import apply_laplacian
from rig.arrays import Bool, Float32, Float64, Int32, Int64


@dataclass(frozen=True, eq=False)
class GridMesh:
    """Triangles between vertices, one vertex at each pixel of a mask.

    Parameters
    ----------
    mask
        ``(H, W)`` bool. The V vertices are numbered in reading order.
    faces
        ``(F, 3)`` int32 vertex numbers, counter-clockwise seen from the front.
    """

    mask: Bool
    faces: Int32

    @cached_property
    def window(self) -> tuple[slice, slice]:
        """The bounding box of the mask, to which all computations of the peers are limited."""
        rows, columns = (np.flatnonzero(self.mask.any(axis=axis)) for axis in (1, 0))
        return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)

    @cached_property
    def inside(self) -> Bool:
        """``(h, w)`` bool: the mask in its window."""
        return np.ascontiguousarray(self.mask[self.window])

    @cached_property
    def edges(self) -> tuple[Float32, Float32]:
        """``right`` and ``down``, ``(h+2, w+2)``: 1/4 for each edge along a row or a column.

        Both have an empty border, as in `processing.surface.grid_graph`. They are proportional to
        the cotangent weights of a flat grid, which are 0 on the diagonals of its squares.
        """
        right = np.zeros(np.add(self.inside.shape, 2), np.float32)
        down = np.zeros_like(right)
        padded = np.pad(self.inside, 1)
        _mark_edges(
            self.faces,
            np.flatnonzero(padded),
            padded.shape[1],
            right.reshape(-1),
            down.reshape(-1),
        )
        return right, down

    def base(self, vertices: Float32, w: int) -> Float32:
        """Return the smooth base of vertices, or of other values.

        Parameters
        ----------
        vertices
            ``(V, k)`` float32, k up to 4.
        w
            Half width of the paper's window: sigma is w / 2, cut off at w. Only pixels with a
            vertex count.
        """
        kernel = cv2.getGaussianKernel(2 * w + 1, w / 2, cv2.CV_32F)
        image = np.zeros((*self.inside.shape, vertices.shape[1] + 1), np.float32)
        image[self.inside, :-1] = vertices
        image[..., -1] = self.inside
        smooth = cv2.sepFilter2D(image, -1, kernel, kernel, borderType=cv2.BORDER_CONSTANT)
        sums = smooth[self.inside]
        return np.asarray(sums[:, :-1] / sums[:, -1:], np.float32)

    def laplacian(self, values: Float32 | Float64) -> Float64:
        """Return the differences ``(V, k)`` between values and those of their neighbours.

        Each is a quarter of the sum over the up to four neighbours along rows and columns.
        """
        right, down = self.edges
        inside = np.pad(self.inside, 1)
        out = np.zeros(values.shape, np.float64)
        padded, applied = np.zeros((2, *inside.shape))
        for axis in range(values.shape[1]):
            padded[inside] = values[:, axis]
            apply_laplacian(right, down, padded, applied)
            out[:, axis] = applied[inside]
        return out

    def normals(self, vertices: Float32) -> Float32:
        """Return area-weighted unit normals ``(V, 3)``; (0, 0, 1) for a vertex without a face."""
        return _vertex_normals(vertices, self.faces)


@numba.njit(cache=True)
def _mark_edges(faces: Int32, pixels: Int64, width: int, right: Float32, down: Float32) -> None:
    for f in range(len(faces)):
        for k in range(3):
            a, b = pixels[faces[f, k]], pixels[faces[f, (k + 1) % 3]]
            if abs(a - b) == 1:
                right[min(a, b)] = 0.25
            elif abs(a - b) == width:
                down[min(a, b)] = 0.25


@numba.njit(cache=True)
def _vertex_normals(vertices: Float32, faces: Int32) -> Float32:
    total = np.zeros(vertices.shape, np.float64)
    for f in range(len(faces)):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        ax = np.float64(vertices[j, 0]) - vertices[i, 0]
        ay = np.float64(vertices[j, 1]) - vertices[i, 1]
        az = np.float64(vertices[j, 2]) - vertices[i, 2]
        bx = np.float64(vertices[k, 0]) - vertices[i, 0]
        by = np.float64(vertices[k, 1]) - vertices[i, 1]
        bz = np.float64(vertices[k, 2]) - vertices[i, 2]
        x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        for v in (i, j, k):
            total[v, 0] += x
            total[v, 1] += y
            total[v, 2] += z
    out = np.zeros(vertices.shape, np.float32)
    for v in range(len(out)):
        length = math.sqrt(total[v, 0] ** 2 + total[v, 1] ** 2 + total[v, 2] ** 2)
        if length > 0:
            for c in range(3):
                out[v, c] = total[v, c] / length
        else:
            out[v, 2] = 1
    return out
