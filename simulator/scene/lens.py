"""The simulator's own lens: from pixels to rays, and from points to pixels.

It does not use the methods of ``CameraModel``, so that the ground truth shares no error with them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, DataError
from rig import short_repr
from rig.arrays import Float64, Int64, Integer
from simulator.scene.distortion import distorted, undistorted
from simulator.shapes.ranges import check_positive, check_within

_CFA_CHANNEL = {"R": 0, "G": 1, "B": 2}
# Supported mosaics, by their first 2 x 2 pixels.
CFAS = ("RGGB", "GRBG", "GBRG", "BGGR")
_OUTLINE = 256
# Standard deviation of the Gaussian closest to an Airy pattern, in wavelengths times f-number
# (Zhang, Zerubia and Olivo-Marin, Gaussian approximations of fluorescence microscope point-spread
# function models, 2007).
_AIRY = 0.42


def directions_across(axes: Float64) -> tuple[Float64, Float64]:
    """Return two unit vectors at right angles to each axis ``(n, 3)`` and to each other."""
    helper = np.where(np.abs(axes[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(axes, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(axes, first)


@dataclass(frozen=True)
class Optics:
    """Aperture and focus of a perspective lens.

    Parameters
    ----------
    f_number
        Focal length over diameter of the aperture.
    focal_length_mm
        Focal length; with the camera's matrix, it determines the size of a pixel.
    focus_mm
        Distance of the plane of focus from the centre of projection, larger than the focal length;
        None for the camera's working distance.
    wavelength_um
        Wavelength of the light.

    Raises
    ------
    DataError
        If a value is not positive.
    """

    f_number: float = 8.0
    focal_length_mm: float = 16.0
    focus_mm: float | None = None
    wavelength_um: float = 0.55

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_positive("lens", **{k: v for k, v in vars(self).items() if v is not None})

    def circle_px(self, depth_mm: Float64, focus_mm: float, focal_px: float) -> Float64:
        """Return the diameters of the circles of confusion of points at depths.

        A point at depth s has the diameter ``focal_length / f_number * focal_px |1/s - 1/focus|``:
        the aperture as seen from the point, on the plane of focus, in pixels of that plane.
        """
        aperture_mm = self.focal_length_mm / self.f_number
        return aperture_mm * focal_px * np.abs(1 / depth_mm - 1 / focus_mm)

    def diffraction_px(self, focal_px: float) -> float:
        """Return the standard deviation of the Gaussian that replaces the Airy pattern.

        The pattern has ``0.42 wavelength v / D`` for the image distance v and the aperture D;
        v in pixels is ``focal_px``.
        """
        return _AIRY * 1e-3 * self.wavelength_um * focal_px * self.f_number / self.focal_length_mm


@dataclass(frozen=True, eq=False)
class Lens:
    """Projection of the camera: perspective with a `CameraModel`, or orthographic along -Z.

    Parameters
    ----------
    camera
        Perspective camera with skew, Brown distortion and a working distance; None for an
        orthographic lens.
    width, height
        Image size in pixels of an orthographic lens, whose axis is at the middle of the image;
        None with a camera, which has its own size.
    pixel_mm
        Side of a pixel on the object; only for an orthographic lens.
    height_mm
        z of the plane from which orthographic rays start; points above it are not seen.
    vignetting
        Strength of the vignetting, 0 to 1: at a field angle t, the image is dimmed to
        ``1 - vignetting * (1 - cos(t)^4)``. An orthographic lens has no field angle and does not
        dim.
    psf_sigma_px
        Standard deviation of the Gaussian blur by the lens's aberrations.
    optics
        Aperture and focus, which add defocus and diffraction to the blur. An orthographic lens has
        neither.
    sharp
        If True, the default, nothing is blurred except mirrored LEDs, by ``psf_sigma_px``: images
        follow closed forms. If False, all that is rendered is blurred.
    cfa
        Colour filters of the first 2 x 2 pixels row by row, for example ``RGGB``; None for a
        monochrome camera.

    Raises
    ------
    DataError
        If a value is out of range, the camera has no working distance, or its distortion folds
        over inside the image, so that two directions meet in one pixel.
    """

    camera: CameraModel | None = None
    width: int | None = None
    height: int | None = None
    pixel_mm: float | None = None
    height_mm: float | None = None
    vignetting: float = 0.0
    psf_sigma_px: float = 0.7
    optics: Optics = field(default_factory=Optics)
    sharp: bool = True
    cfa: str | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_within("lens", 0, 1, vignetting=self.vignetting)
        check_positive("lens", psf_sigma_px=self.psf_sigma_px)
        if self.cfa is not None and self.cfa not in CFAS:
            raise DataError(f"lens: cfa {self.cfa!r} is not one of {', '.join(CFAS)}")
        flat = (self.width, self.height, self.pixel_mm, self.height_mm)
        if self.camera is None:
            self._check_orthographic()
        elif any(value is not None for value in flat):
            raise DataError(
                "lens: width, height, pixel_mm and height_mm are for an orthographic lens, a "
                "camera is for a perspective lens: give one or the other"
            )
        elif self.camera.working_distance_mm is None:
            raise DataError("a simulated camera needs a working distance: give working_distance_mm")
        elif not self.sharp and self._focus_mm <= self.optics.focal_length_mm:
            raise DataError(
                f"lens: the plane of focus at {self._focus_mm:g} mm is within the focal length of "
                f"{self.optics.focal_length_mm:g} mm: give another focus_mm or focal_length_mm"
            )
        else:
            self._check_folds()

    @classmethod
    def orthographic(
        cls, width: int, height: int, pixel_mm: float, height_mm: float, **more: Any
    ) -> Lens:
        """Return an orthographic lens; ``more`` are fields of this class."""
        return cls(width=width, height=height, pixel_mm=pixel_mm, height_mm=height_mm, **more)

    def _check_orthographic(self) -> None:
        if self.width is None or self.height is None or self.width < 1 or self.height < 1:
            raise DataError(
                f"lens: an image size of {self.width} x {self.height} pixels is invalid: give the "
                "size of an orthographic lens, or a camera"
            )
        what = "positive for an orthographic lens"
        check_positive("lens", what=what, pixel_mm=self.pixel_mm, height_mm=self.height_mm)

    def _check_folds(self) -> None:
        if not self._brown.any():
            return
        rows, columns = self.size
        x, y = np.meshgrid(np.linspace(-0.5, columns - 0.5, 65), np.linspace(-0.5, rows - 0.5, 65))
        if not np.isfinite(self.origins_and_rays(x, y)[1]).all():
            raise DataError(
                f"the camera's distortion {self._brown.tolist()} folds the image over itself: "
                "some of its pixels see no direction or two; check its coefficients"
            )

    @property
    def size(self) -> tuple[int, int]:
        """Image shape, (height, width)."""
        if self.camera is not None:
            return self.camera.size
        return int(self.height or 0), int(self.width or 0)

    @property
    def camera_z_mm(self) -> float:
        """Height z of the centre of projection, or of the plane where orthographic rays start."""
        if self.camera is not None:
            return float(self.camera.working_distance_mm or 0.0)
        return float(self.height_mm or 0.0)

    def origins_and_rays(self, x_px: npt.ArrayLike, y_px: npt.ArrayLike) -> tuple[Float64, Float64]:
        """Return the origins and directions of the rays of pixels.

        Parameters
        ----------
        x_px, y_px
            Positions that broadcast against each other; (0, 0) is the centre of the first pixel,
            y points down.

        Returns
        -------
        origins, rays
            ``(..., 3)`` each, the rays scaled to z = -1: ``origin + depth * ray`` is on the ray.
            The ray is NaN for a position outside the image that no direction reaches.
        """
        x, y = np.broadcast_arrays(np.asarray(x_px, np.float64), np.asarray(y_px, np.float64))
        if self.camera is None:
            rows, columns = self.size
            pixel, top = float(self.pixel_mm or 0.0), np.full_like(x, self.camera_z_mm)
            right, up = (x - (columns - 1) / 2) * pixel, ((rows - 1) / 2 - y) * pixel
            origins = np.stack([right, up, top], axis=-1)
            return origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape)
        (fx, skew, cx), (_, fy, cy) = self.camera.K[:2]
        down = (y - cy) / fy
        right = (x - cx - skew * down) / fx
        if self._brown.any():
            right, down = undistorted(right, down, self._brown)
        rays: Float64 = np.stack([right, -down, np.full_like(right, -1.0)], axis=-1)
        return np.broadcast_to([0.0, 0.0, self.camera_z_mm], rays.shape), rays

    def project(self, points_mm: Float64) -> Float64:
        """Return the pixel positions ``(..., 2)`` of points ``(..., 3)`` below ``camera_z_mm``.

        If a point is so far outside the field that the distortion folds it back, its position is
        wrong, as always with Brown's model; the ray of that position then misses the point.
        """
        if self.camera is None:
            rows, columns = self.size
            pixel = float(self.pixel_mm or 1.0)
            x = points_mm[..., 0] / pixel + (columns - 1) / 2
            y = (rows - 1) / 2 - points_mm[..., 1] / pixel
            return np.stack([x, y], axis=-1)
        (fx, skew, cx), (_, fy, cy) = self.camera.K[:2]
        depth = self.camera_z_mm - points_mm[..., 2]
        right, down = points_mm[..., 0] / depth, -points_mm[..., 1] / depth
        if self._brown.any():
            right, down = distorted(right, down, self._brown)
        return np.stack([fx * right + skew * down + cx, fy * down + cy], axis=-1)

    def vignette(self, x_px: npt.ArrayLike, y_px: npt.ArrayLike) -> Float64:
        """Return the share of light that reaches pixels: 1 on the axis, less in the corners."""
        _, rays = self.origins_and_rays(x_px, y_px)
        squared = 1 / (rays**2).sum(axis=-1)
        factor: Float64 = 1 - self.vignetting * (1 - squared**2)
        return factor

    def channel(self, x_px: Integer, y_px: Integer) -> Int64 | None:
        """Return the channel of pixels, 0 red, 1 green, 2 blue; None for a monochrome camera."""
        if self.cfa is None:
            return None
        filters = np.array([_CFA_CHANNEL[letter] for letter in self.cfa], np.int64)
        channels: Int64 = filters[2 * (y_px % 2) + x_px % 2]
        return channels

    def circle_px(self, depth_mm: Float64) -> Float64:
        """Return the diameters of the circles of confusion of points at depths from the camera.

        They are 0 for a sharp and for an orthographic lens.
        """
        if self.camera is None or self.sharp:
            return np.zeros(np.shape(depth_mm))
        return self.optics.circle_px(depth_mm, self._focus_mm, float(self.camera.K[0, 0]))

    @property
    def blur_px(self) -> float:
        """Standard deviation of the Gaussian blur of all that is in focus, in pixels.

        Aberrations and diffraction; ``psf_sigma_px`` alone for a sharp and an orthographic lens.
        """
        if self.camera is None or self.sharp:
            return self.psf_sigma_px
        return math.hypot(self.psf_sigma_px, self.optics.diffraction_px(float(self.camera.K[0, 0])))

    def eye_to(self, points_mm: Float64) -> Float64:
        """Return the unit directions ``(..., 3)`` from points toward the camera."""
        if self.camera is None:
            return np.broadcast_to([0.0, 0.0, 1.0], points_mm.shape)
        toward = np.array([0.0, 0.0, self.camera_z_mm]) - points_mm
        return np.asarray(toward / np.linalg.norm(toward, axis=-1, keepdims=True))

    def window(self, centre_mm: npt.ArrayLike, radius_mm: float) -> tuple[slice, slice]:
        """Return the rows and columns that contain a ball's outline, with a margin of one pixel.

        The outline is the circle where rays touch the ball. It is sampled densely and projected,
        so the result also holds for a distorted outline.
        """
        centre = np.asarray(centre_mm, np.float64)
        toward = self.eye_to(centre)
        sine = 0.0
        if self.camera is not None:
            sine = radius_mm / float(np.linalg.norm([*centre[:2], self.camera_z_mm - centre[2]]))
        first, second = directions_across(toward[None])
        angle = np.arange(_OUTLINE)[:, None] * (2 * math.pi / _OUTLINE)
        around = np.cos(angle) * first + np.sin(angle) * second
        circle = radius_mm * (sine * toward + math.sqrt(max(1 - sine**2, 0.0)) * around)
        pixels = self.project(centre + circle)
        rows, columns = self.size
        low, high = np.floor(pixels.min(axis=0)) - 1, np.ceil(pixels.max(axis=0)) + 2
        left, top = (int(v) for v in np.clip(low, 0, (columns, rows)))
        right, bottom = (int(v) for v in np.clip(high, 0, (columns, rows)))
        return slice(top, bottom), slice(left, right)

    @property
    def _focus_mm(self) -> float:
        return self.camera_z_mm if self.optics.focus_mm is None else self.optics.focus_mm

    @cached_property
    def _brown(self) -> Float64:
        """Coefficients k1, k2, p1, p2, k3."""
        return np.zeros(5) if self.camera is None else np.asarray(self.camera.distortion)
