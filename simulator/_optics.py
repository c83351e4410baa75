"""The simulator's own pinhole: rays of pixels and pixels of points.

Written apart from ``CameraModel``'s methods, so that the truth shares no mistake with them.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, DataError

Array = npt.NDArray[np.float64]


def check_camera(camera: CameraModel) -> None:
    """Raise DataError for a camera that the renderer cannot imitate."""
    if camera.working_distance_mm is None:
        raise DataError("a simulated camera needs a working distance: give working_distance_mm")
    if np.any(camera.distortion):
        raise DataError("the renderer draws no lens distortion yet: give a camera without it")


def centre(camera: CameraModel) -> Array:
    """Return the centre of projection, (0, 0, working distance)."""
    check_camera(camera)
    return np.array([0.0, 0.0, float(camera.working_distance_mm or 0.0)])


def pixel_rays(camera: CameraModel, x_px: npt.ArrayLike, y_px: npt.ArrayLike) -> Array:
    """Return the directions that pixels see.

    Parameters
    ----------
    camera
        A pinhole without distortion.
    x_px, y_px
        Positions of any one shape, (0, 0) the centre of the first pixel, y down.

    Returns
    -------
    Array
        ``(..., 3)``, scaled to z = -1: ``centre + depth * ray`` lies on the ray.
    """
    (fx, skew, cx), (_, fy, cy) = camera.K[:2]
    down = (np.asarray(y_px, np.float64) - cy) / fy
    right = (np.asarray(x_px, np.float64) - cx - skew * down) / fx
    rays: Array = np.stack([right, -down, np.full_like(right, -1.0)], axis=-1)
    return rays


def project(camera: CameraModel, points_mm: Array) -> Array:
    """Return the pixel positions ``(..., 2)`` of points ``(..., 3)`` in front of the camera."""
    (fx, skew, cx), (_, fy, cy) = camera.K[:2]
    depth = float(camera.working_distance_mm or 0.0) - points_mm[..., 2]
    right, down = points_mm[..., 0] / depth, -points_mm[..., 1] / depth
    pixels: Array = np.stack([fx * right + skew * down + cx, fy * down + cy], axis=-1)
    return pixels
