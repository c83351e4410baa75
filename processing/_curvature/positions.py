"""How far apart neighbouring pixels are on a surface."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel

Double = npt.NDArray[np.float64]

# Cosine of the angle to the line of sight, within 6 degrees of edge-on.
_LEAST_FACING = 0.1


def surface_steps(camera: CameraModel, normals: Double, depth: Double, first_row: int) -> Double:
    """Return the change of X and Y of the surface from pixel to pixel.

    A surface point is ``centre + d r`` with the ray r. Its tangents are at right angles to the
    normal n, so the depth changes by ``-d (n . dr) / (n . r)``.

    Parameters
    ----------
    camera
        The camera.
    normals
        ``(3, R, W)`` unit normals of some rows.
    depth
        ``(R, W)`` depth d along the optical axis.
    first_row
        Row of the first of them in the image.

    Returns
    -------
    NDArray
        ``(2, 2, R, W)``: X and Y by one pixel to the right and one up, in the unit of the depth.
        NaN where the surface is seen from behind or edge-on.
    """
    rows, columns = depth.shape
    x, y = np.meshgrid(np.arange(columns, dtype=np.float64), np.arange(rows) + float(first_row))

    def rays(right: float, up: float) -> Double:
        return np.moveaxis(camera.rays(np.stack([x + right, y - up], axis=-1)), -1, 0)

    ray = rays(0, 0)
    facing = -np.sum(normals * ray, axis=0)
    facing = np.where(facing > _LEAST_FACING * np.linalg.norm(ray, axis=0), facing, np.nan)
    steps = np.zeros((2, 2, rows, columns))
    for i, (right, up) in enumerate(((0.5, 0.0), (0.0, 0.5))):
        change = rays(right, up) - rays(-right, -up)
        deeper = depth * np.sum(normals * change, axis=0) / facing
        steps[:, i] = deeper * ray[:2] + depth * change[:2]
    return steps
