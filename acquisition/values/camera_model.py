"""Geometric camera model: the ray of each pixel."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError
from rig.arrays import Float64

# OpenCV's camera looks along +Z with Y down; in the house frame it looks along -Z with Y up.
_FLIP = np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class CameraModel:
    """A pinhole camera with Brown distortion, looking along -Z at the working plane z = 0.

    Parameters
    ----------
    K
        ``(3, 3)`` intrinsic matrix in pixels; the centre of the first pixel is at (0, 0).
    width, height
        Image size in pixels.
    working_distance_mm
        Distance from the centre of projection to the working plane along the optical axis; None if
        the scale is not known.
    distortion
        ``(5,)`` OpenCV coefficients k1, k2, p1, p2, k3.
    lens
        Name of the lens; empty if it is not known.
    focus_mm
        Distance to which the lens was focused when it was calibrated; None if it is not known.

    Raises
    ------
    DataError
        If K is not an upper triangular matrix with positive focal lengths, a size, the working
        distance or the focus is not positive, or a distortion coefficient is not finite.
    """

    K: Float64
    width: int
    height: int
    working_distance_mm: float | None = None
    distortion: Float64 = field(default_factory=lambda: np.zeros(5))
    lens: str = ""
    focus_mm: float | None = None

    def __repr__(self) -> str:
        distance = self.working_distance_mm
        far = "" if distance is None else f", working distance {distance:g} mm"
        size = f"{self.width} x {self.height} px"
        return f"CameraModel({size}, focal length {self.focal_px:.1f} px{far})"

    def __post_init__(self) -> None:
        K = np.array(self.K, np.float64)
        if K.shape != (3, 3) or not np.isfinite(K).all():
            raise DataError("the camera matrix K must have 3 x 3 finite numbers")
        if (
            K[0, 0] <= 0
            or K[1, 1] <= 0
            or abs(K[2, 2] - 1) > 1e-9
            or np.any(K[[1, 2, 2], [0, 0, 1]])
        ):
            raise DataError(
                "the camera matrix K must have the form [fx s cx; 0 fy cy; 0 0 1] with positive "
                "focal lengths"
            )
        if self.width < 1 or self.height < 1:
            raise DataError(
                f"a camera image of {self.width} x {self.height} pixels has no pixels: give its "
                "width and height"
            )
        lengths = {"working distance": self.working_distance_mm, "focus": self.focus_mm}
        for name, length in lengths.items():
            if length is not None and not (np.isfinite(length) and length > 0):
                raise DataError(f"the {name} must be positive and finite, not {length} mm")
        distortion = np.array(self.distortion, np.float64).ravel()
        if len(distortion) > 5 or not np.isfinite(distortion).all():
            raise DataError("the distortion must have at most five finite numbers: k1 k2 p1 p2 k3")
        object.__setattr__(self, "K", K)
        object.__setattr__(self, "distortion", np.pad(distortion, (0, 5 - len(distortion))))

    @property
    def size(self) -> tuple[int, int]:
        """Shape of the image, (height, width)."""
        return self.height, self.width

    @property
    def focal_px(self) -> float:
        """Geometric mean of the focal lengths in pixels; a pixel spans ``1 / focal_px`` radians."""
        return float(np.sqrt(self.K[0, 0] * self.K[1, 1]))

    @property
    def centre_mm(self) -> Float64:
        """Centre of projection, ``(0, 0, working distance)``."""
        if self.working_distance_mm is None:
            raise DataError("this camera has no working distance: add working_distance_mm to it")
        return np.array([0.0, 0.0, self.working_distance_mm])

    def from_opencv(self, points_mm: npt.ArrayLike) -> Float64:
        """Return points of OpenCV's camera frame in the house frame, ``(..., 3)`` mm.

        The origin of OpenCV's frame is the centre of projection; X points right, Y down and Z away
        from the camera. Directions are converted by the difference of two points.
        """
        points: Float64 = self.centre_mm + np.asarray(points_mm, np.float64) * _FLIP
        return points

    def cropped(self, x: int, y: int, width: int, height: int) -> CameraModel:
        """Return the camera of a region of its images: the principal point moves.

        Parameters
        ----------
        x, y
            Column and row of the region's first pixel.
        width, height
            Size of the region in pixels.
        """
        K = self.K - np.array([[0.0, 0.0, x], [0.0, 0.0, y], [0.0, 0.0, 0.0]])
        return replace(self, K=K, width=width, height=height)

    def downscaled(self, factor: int) -> CameraModel:
        """Return the camera of images in which ``factor x factor`` pixels were averaged.

        The centre of the first block is at (factor - 1) / 2 in both axes. Columns and rows that do
        not fill a block are left out.
        """
        K = self.K.copy()
        K[:2, 2] -= (factor - 1) / 2
        K[:2] /= factor
        return replace(self, K=K, width=self.width // factor, height=self.height // factor)

    def upscaled(self, factor: int) -> CameraModel:
        """Return the camera of images in which each pixel became ``factor x factor`` pixels."""
        K = self.K.copy()
        K[:2] *= factor
        K[:2, 2] += (factor - 1) / 2
        return replace(self, K=K, width=self.width * factor, height=self.height * factor)

    def rays(self, pixels: npt.ArrayLike) -> Float64:
        """Return the viewing directions of pixels in the house frame, scaled to z = -1.

        A surface point is ``centre + depth * ray``, with the depth along the optical axis.

        Parameters
        ----------
        pixels
            ``(..., 2)`` positions (x, y) in pixels.

        Returns
        -------
        Array
            ``(..., 3)`` float64.
        """
        points = np.asarray(pixels, np.float64)
        # K is applied here because OpenCV ignores the skew.
        y = (points[..., 1] - self.K[1, 2]) / self.K[1, 1]
        x = (points[..., 0] - self.K[0, 2] - self.K[0, 1] * y) / self.K[0, 0]
        if self.distortion.any() and points.size:  # OpenCV refuses empty arrays
            criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-12)
            seen = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
            straight = cv2.undistortPoints(seen, np.eye(3), self.distortion, criteria=criteria)
            x, y = np.moveaxis(straight.reshape(points.shape), -1, 0)
        rays: Float64 = np.stack([x, y, np.ones_like(x)], axis=-1) * _FLIP
        return rays

    def pixel_rays(self) -> Float64:
        """Return the ray of every pixel, ``(height, width, 3)``."""
        x, y = np.meshgrid(np.arange(self.width), np.arange(self.height))
        return self.rays(np.stack([x, y], axis=-1))

    def points_on_plane(self, z_mm: float = 0.0) -> Float64:
        """Return the points ``(height, width, 3)`` at which rays meet the plane z = ``z_mm``."""
        return self.points_at(np.asarray(self.centre_mm[2] - z_mm))

    def points_at(self, depth_mm: npt.ArrayLike) -> Float64:
        """Return the points ``(height, width, 3)`` of all pixels at depths ``(height, width)``."""
        points: Float64 = self.pixel_rays()
        points *= np.asarray(depth_mm)[..., None]
        points += self.centre_mm
        return points

    def project(self, points_mm: npt.ArrayLike) -> Float64:
        """Return the pixels ``(..., 2)`` that show points ``(..., 3)`` of the house frame."""
        points = (np.asarray(points_mm, np.float64) - self.centre_mm) * _FLIP
        if not points.size:  # OpenCV refuses empty arrays
            return np.zeros((*points.shape[:-1], 2))
        if self.distortion.any():
            seen, _ = cv2.projectPoints(
                points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), np.eye(3), self.distortion
            )
            x, y = np.moveaxis(np.asarray(seen, np.float64).reshape(*points.shape[:-1], 2), -1, 0)
        else:  # several times as fast, with the same rounding
            inverse = 1 / np.where(points[..., 2] == 0, 1.0, points[..., 2])
            x, y = points[..., 0] * inverse, points[..., 1] * inverse
        across = self.K[0, 0] * x + self.K[0, 1] * y + self.K[0, 2]
        pixels: Float64 = np.stack([across, self.K[1, 1] * y + self.K[1, 2]], axis=-1)
        return pixels
