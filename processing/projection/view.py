"""Views of an object: rotations, and the raster of pixels that it is drawn to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from acquisition import CameraModel, DataError
from rig.arrays import Float64

View = Literal["front", "back", "left", "right", "top", "bottom"]

# Viewing directions with Y up: "left" is the view from -X.
_LOOKS: dict[View, tuple[float, float, float]] = {
    "front": (0, 0, -1),
    "back": (0, 0, 1),
    "left": (1, 0, 0),
    "right": (-1, 0, 0),
    "top": (0, -1, 0),
    "bottom": (0, 1, 0),
}
# In files with Z up the front is toward -Y.
_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
# Margin around an object that is fitted into the raster.
_MARGIN_PX = 2
_DEFAULT_SIDE_PX = 1024
_MAX_SIDE_PX = 65_536
MAX_PROJECTED_PIXELS = 100_000_000


def view_rotation(
    view: View = "front",
    *,
    look: Sequence[float] | None = None,
    up: Literal["y", "z"] = "y",
    rotate_deg: Sequence[float] = (0.0, 0.0, 0.0),
) -> Float64:
    """Return the rotation from a file's axes to the house frame.

    Parameters
    ----------
    view
        The visible side.
    look
        Viewing direction ``(x, y, z)`` in the file's axes, of any length; replaces `view`. The up
        axis points up in the image; if the direction is straight down or up, the orientation is
        that of the views ``top`` and ``bottom``.
    up
        The axis of the file that points up; ``z`` is usual in engineering, with the front toward
        -Y.
    rotate_deg
        Additional rotations of the object about X (right), then Y (up), then Z (toward the
        viewer).

    Returns
    -------
    Double
        ``(3, 3)`` rotation; ``points @ R.T`` rotates points.

    Raises
    ------
    DataError
        If `look` has no direction, or a number is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.projection import view_rotation
    >>> bool((view_rotation("front") == np.eye(3)).all())
    True
    >>> (view_rotation("top") @ [0, 1, 0]).round()  # up in the file points to the viewer
    array([0., 0., 1.])
    """
    to_y_up = np.eye(3) if up == "y" else _Z_UP
    sight = np.array(_LOOKS[view], np.float64)
    if look is not None:
        sight = to_y_up @ np.asarray(look, np.float64)
    length = float(np.linalg.norm(sight))
    if not (math.isfinite(length) and length > 0 and np.isfinite(rotate_deg).all()):
        raise DataError(
            f"no view along {look}, rotated by {rotate_deg} degrees: give finite numbers and a "
            "direction that is not 0"
        )
    toward = -sight / length
    level = math.hypot(toward[0], toward[2])
    right = np.array([toward[2], 0.0, -toward[0]]) / level if level > 1e-9 else np.eye(3)[0]
    turn: Float64 = np.stack([right, np.cross(toward, right), toward]) @ to_y_up
    for axis, angle in enumerate(np.radians(rotate_deg)):
        about = np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        about[i, i] = about[j, j] = math.cos(angle)
        about[i, j], about[j, i] = -math.sin(angle), math.sin(angle)
        turn = about @ turn
    return turn


@dataclass(frozen=True, eq=False)
class Raster:
    """The pixels that an object is drawn to.

    Parameters
    ----------
    size
        (height, width) in pixels.
    pixel_mm
        Distance between neighbouring pixels on the object; with a camera, at the working distance.
    camera
        A perspective camera with a working distance; None for an orthographic view with the origin
        in the middle.

    Raises
    ------
    DataError
        If the image has more than 100 million pixels, or more than 65 536 on a side.
    """

    size: tuple[int, int]
    pixel_mm: float
    camera: CameraModel | None = None

    def __post_init__(self) -> None:
        height, width = self.size
        if max(height, width) > _MAX_SIDE_PX or height * width > MAX_PROJECTED_PIXELS:
            raise DataError(
                f"an image of {width} x {height} pixels is too large, the maximum is "
                f"{MAX_PROJECTED_PIXELS // 10**6} million pixels: choose a larger pixel size or a "
                "smaller image"
            )

    @property
    def eye_mm(self) -> float:
        """Height of the centre of projection; 0 for an orthographic view."""
        return 0.0 if self.camera is None else float(self.camera.centre_mm[2])

    def pixels(self, points_mm: Float64) -> tuple[Float64, Float64]:
        """Return the pixels ``(N, 2)`` of points ``(N, 3)``, and their nearness ``(N,)``.

        The nearness increases toward the viewer and is linear over the image of a plane. If there
        is a camera, the points must be in front of it.
        """
        if self.camera is None:
            middle = np.array([(self.size[1] - 1) / 2, (self.size[0] - 1) / 2])
            scale = np.array([1.0, -1.0]) / self.pixel_mm
            return points_mm[:, :2] * scale + middle, points_mm[:, 2].copy()
        nearness = 1.0 / (self.eye_mm - points_mm[:, 2])
        if self.camera.distortion.any():
            return self.camera.project(points_mm), nearness
        origin, right, down = self._pinhole(self.camera)
        to_pixels = np.linalg.inv(np.stack([right, down], axis=1))
        x, y = (points_mm[:, axis] * nearness - origin[axis] for axis in (0, 1))
        return np.stack([row[0] * x + row[1] * y for row in to_pixels], axis=1), nearness

    def sights(self) -> tuple[Float64, Float64, Float64]:
        """Return the lines of sight: x of the columns, y of the rows, and slopes.

        They are explained in `processing.projection.rasterize_kernels.shade`.
        """
        height, width = self.size
        if self.camera is None:
            x = (np.arange(width, dtype=np.float64) - (width - 1) / 2) * self.pixel_mm
            y = ((height - 1) / 2 - np.arange(height, dtype=np.float64)) * self.pixel_mm
            return x, y, np.zeros((1, 1, 2))
        if self.camera.distortion.any():
            rays = np.ascontiguousarray(self.camera.pixel_rays()[..., :2])
        else:
            origin, right, down = self._pinhole(self.camera)
            along = origin + np.arange(width)[:, None] * right
            rays = along + (np.arange(height)[:, None] * down)[:, None]
        return np.zeros(width), np.zeros(height), rays

    @staticmethod
    def _pinhole(camera: CameraModel) -> tuple[Float64, Float64, Float64]:
        """Return the slope of the first pixel's ray, and its steps to the right and down.

        A pinhole camera is linear; the general method takes ten times as long for millions of
        points.
        """
        origin, right, down = camera.rays([[0, 0], [1, 0], [0, 1]])[:, :2]
        return origin, right - origin, down - origin


def fit_raster(
    low_mm: Float64,
    high_mm: Float64,
    size: tuple[int, int] | None,
    pixel_mm: float | None,
    camera: CameraModel | None = None,
) -> Raster:
    """Return the raster of a camera, or for an image size and a pixel size; None is fitted.

    ``low_mm`` and ``high_mm`` are the smallest and largest x, y, z of the object.

    Raises
    ------
    DataError
        If the object has no extent in the image plane, the image is too large, or the camera has no
        working distance or excludes what else is given.
    """
    if pixel_mm is not None and not (math.isfinite(pixel_mm) and pixel_mm > 0):
        raise DataError(f"a pixel of {pixel_mm} mm is not a positive length")
    if camera is not None:
        return _raster_of(camera, size, pixel_mm)
    half_x, half_y = (max(-low, high) for low, high in zip(low_mm[:2], high_mm[:2], strict=True))
    if pixel_mm is None:
        if not max(half_x, half_y) > 0:
            raise DataError("the object is a point in this view: give a pixel size")
        height, width = size if size is not None else (_DEFAULT_SIDE_PX, _DEFAULT_SIDE_PX)
        pixel_mm = max(
            2 * half_x / max(width - 2 * _MARGIN_PX, 1),
            2 * half_y / max(height - 2 * _MARGIN_PX, 1),
        )
    if size is None:
        height_px, width_px = (
            math.ceil(2 * half / pixel_mm - 1e-9) + 2 * _MARGIN_PX for half in (half_y, half_x)
        )
        size = height_px, width_px
    return Raster(size, float(pixel_mm))


def _raster_of(camera: CameraModel, size: tuple[int, int] | None, pixel_mm: float | None) -> Raster:
    if camera.working_distance_mm is None:
        raise DataError(
            "the camera has no working distance: add working_distance_mm to the camera file"
        )
    if pixel_mm is not None:
        raise DataError(
            f"a pixel size of {pixel_mm} mm and a camera at {camera.working_distance_mm} mm "
            "exclude each other: give only one of them"
        )
    if size is not None and size != camera.size:
        raise DataError(
            f"an image of {size[1]} x {size[0]} pixels was requested for a camera of "
            f"{camera.width} x {camera.height}: leave out the size"
        )
    return Raster(camera.size, camera.working_distance_mm / camera.focal_px, camera)
