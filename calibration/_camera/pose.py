"""Pose of a calibration board in one view of a known camera."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from calibration._camera.view import BoardView
from calibration._errors import EstimateError

Array = npt.NDArray[np.float64]


def pose_of(view: BoardView, K: Array, distortion: Array) -> tuple[Array, Array]:
    """Return rotation vector and translation of the board in OpenCV's camera frame.

    Raises
    ------
    EstimateError
        If the corners have no pose.
    """
    found, turn, shift = cv2.solvePnP(
        view.points_mm, view.corners_px[:, None], K, distortion, flags=cv2.SOLVEPNP_IPPE
    )
    if not found or not np.isfinite(turn).all() or not np.isfinite(shift).all():
        raise EstimateError(f"{view.name}: the corners of the calibration board have no pose")
    turn, shift = cv2.solvePnPRefineLM(
        view.points_mm, view.corners_px[:, None], K, distortion, turn, shift
    )
    return np.ravel(turn), np.ravel(shift)
