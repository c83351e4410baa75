"""What a calibration of a camera returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel
from calibration._camera.view import BoardView
from rig import Notice, short_repr

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CalibratedView:
    """A view of the board after the calibration.

    Parameters
    ----------
    view
        The corners that were found.
    kept
        ``(n,)`` False for corners that were left out as outliers; all False for a view that was
        left out.
    residuals_px
        ``(n, 2)`` seen minus predicted corners.
    tilt_deg
        Angle between the board and the image plane.
    distance_mm
        Distance of the middle of its corners from the camera, along the optical axis.
    """

    view: BoardView
    kept: npt.NDArray[np.bool_]
    residuals_px: Array
    tilt_deg: float
    distance_mm: float

    __repr__ = short_repr

    @property
    def used(self) -> bool:
        """Whether the view was used."""
        return bool(self.kept.any())

    @property
    def rms_px(self) -> float:
        """Rms distance between seen and predicted corners: of the kept ones, if it was used."""
        shown = self.residuals_px[self.kept] if self.used else self.residuals_px
        return float(np.sqrt(np.mean(np.sum(shown**2, axis=1))))


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """A camera with its standard deviations.

    Parameters
    ----------
    camera
        The camera, without a working distance.
    sigma
        Standard deviations of fx, fy, cx, cy in pixels and of the coefficients k1, k2, p1, p2, k3
        that the views determine; the other coefficients are 0.
    covariance
        ``(9, 9)`` covariance of fx, fy, cx, cy, k1, k2, p1, p2, k3; 0 for those that are not
        determined.
    sigma_px
        Standard deviation of a coordinate of a corner, from the residuals.
    views
        All views, in their order; views of the same place are one view.
    covered
        ``(rows, columns)`` True for cells of the field of view that lie within the corners of a
        view.
    bare_corners
        Corners of the image that are hardly covered, such as ``upper left``.
    warnings
        Notices, each with its code.
    """

    camera: CameraModel
    sigma: Mapping[str, float]
    covariance: Array
    sigma_px: float
    views: tuple[CalibratedView, ...]
    covered: npt.NDArray[np.bool_]
    bare_corners: tuple[str, ...]
    warnings: tuple[Notice, ...] = ()

    __repr__ = short_repr

    @property
    def coverage(self) -> float:
        """Share of the field of view that lies within the corners of a view, 0 to 1."""
        return float(self.covered.mean())
