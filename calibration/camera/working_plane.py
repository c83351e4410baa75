"""Working distance and scale from a view of the board on the working plane."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from acquisition import CameraModel
from calibration._errors import DataError
from calibration.camera.board import BoardView
from calibration.camera.calibrate import CameraCalibration
from calibration.camera.fit import pose_of, projected
from rig import Notice, short_repr
from rig.arrays import Float64

_TILTED_DEG: Final = 0.5
_INCONSISTENT: Final = 3.0
_ROUNDING_PX: Final = 0.05


@dataclass(frozen=True, eq=False)
class WorkingPlane:
    """The working plane as a camera sees it.

    Parameters
    ----------
    camera
        The calibrated camera with its working distance.
    sigma_mm
        Standard deviation of the working distance, without the error of the print.
    mm_per_px
        Size of a pixel on the working plane, in the middle of the image.
    tilt_deg
        Angle between the board and the plane at right angles to the optical axis.
    rms_px
        Rms distance between seen and predicted corners.
    warnings
        Notices, each with its code.
    """

    camera: CameraModel
    sigma_mm: float
    mm_per_px: float
    tilt_deg: float
    rms_px: float
    warnings: tuple[Notice, ...] = ()

    __repr__ = short_repr


def find_working_plane(
    calibrated: CameraCalibration, view: BoardView, *, height_mm: float = 0.0
) -> WorkingPlane:
    """Measure the working distance with a board that lies on the working plane.

    Parameters
    ----------
    calibrated
        The camera.
    view
        View of the board on the working plane, from `find_board`, with the same camera.
    height_mm
        Height of the printed side above the working plane, such as the thickness of the board.

    Returns
    -------
    WorkingPlane
        The distance is measured along the optical axis, to the point where it meets the plane.

    Raises
    ------
    DataError
        If the image has another size than those of the calibration, or the working distance would
        not be positive.
    EstimateError
        If the corners have no pose.

    Examples
    --------
    >>> import cv2, numpy as np
    >>> from calibration import CharucoBoard, calibrate_camera, find_board
    >>> from calibration.camera import find_working_plane
    >>> from simulator import Lens, bench_camera
    >>> from simulator.rendering import board_view
    >>> from simulator.shapes import ChArUco
    >>> def seen(*tilt, lens=Lens(bench_camera())):
    ...     turn, _ = cv2.Rodrigues(np.array([*tilt, 0.0]))
    ...     sheet = board_view(lens, ChArUco(7, 5, 30), turn, (0, 0, 0), sheet_mm=(230, 170))
    ...     return find_board(sheet, CharucoBoard(7, 5, 30))
    >>> found = calibrate_camera([seen(0.4, 0), seen(0, 0.4), seen(-0.4, 0.1), seen(0.1, -0.4)])
    >>> round(find_working_plane(found, seen(0, 0)).camera.working_distance_mm, -1)
    600.0
    """
    camera = calibrated.camera
    if view.size != camera.size:
        raise DataError(
            f"{view.name}: {view.size[1]} x {view.size[0]} pixels, but the camera was calibrated "
            f"with {camera.width} x {camera.height}: give an image of the same size"
        )
    distance, normal, pose = _distance(view, camera.K, camera.distortion)
    working_mm = distance + height_mm
    if not working_mm > 0:
        raise DataError(f"{view.name}: a height of {height_mm:g} mm is above the camera")
    predicted, by_pose, _ = projected(view.points_mm, pose, camera.K, camera.distortion)
    rms = float(np.sqrt(np.mean(np.sum((view.corners_px - predicted) ** 2, axis=1))))
    variance = _variance_of_corners(by_pose, pose, calibrated.sigma_px)
    variance += _variance_of_camera(calibrated, view, distance)
    tilt = float(np.degrees(np.arctan2(np.hypot(normal[0], normal[1]), abs(normal[2]))))
    notices = []
    if tilt > _TILTED_DEG:
        text = (
            f"the board on the working plane is tilted by {tilt:.1f} degrees to the image plane: "
            "is it flat on the working plane, and does the camera look straight down?"
        )
        notices.append(Notice("working-plane-tilted", text, view.name))
    if rms > max(_INCONSISTENT * np.sqrt(2) * calibrated.sigma_px, _ROUNDING_PX):
        text = (
            f"the calibrated camera does not explain this view ({rms:.2f} px, usually "
            f"{np.sqrt(2) * calibrated.sigma_px:.2f} px): are zoom and focus the same?"
        )
        notices.append(Notice("working-plane-contradicts", text, view.name))
    return WorkingPlane(
        replace(camera, working_distance_mm=working_mm),
        float(np.sqrt(variance)),
        working_mm / camera.focal_px,
        tilt,
        rms,
        tuple(notices),
    )


def _distance(
    view: BoardView, K: Float64, distortion: Float64
) -> tuple[float, Float64, tuple[Float64, Float64]]:
    """Return the depth at which the optical axis meets the board, its normal and its pose."""
    pose = pose_of(view, K, distortion)
    return (*_meets_axis(pose), pose)


def _meets_axis(pose: tuple[Float64, Float64]) -> tuple[float, Float64]:
    normal: Float64 = np.asarray(cv2.Rodrigues(pose[0])[0], np.float64)[:, 2]
    return float(normal @ pose[1] / normal[2]), normal


def _variance_of_corners(by_pose: Float64, pose: tuple[Float64, Float64], sigma_px: float) -> float:
    """Return the variance of the distance from the errors of the corners."""
    covariance = sigma_px**2 * np.linalg.pinv(by_pose.T @ by_pose)
    values = np.concatenate(pose)
    slope = np.zeros(6)
    for k in range(6):
        step = 1e-6 * max(1.0, abs(values[k]))
        ends = [values + sign * step * np.eye(6)[k] for sign in (1, -1)]
        high, low = (_meets_axis((end[:3], end[3:]))[0] for end in ends)
        slope[k] = (high - low) / (2 * step)
    return float(slope @ covariance @ slope)


def _variance_of_camera(calibrated: CameraCalibration, view: BoardView, distance: float) -> float:
    """Return the variance of the distance from the errors of the camera."""
    camera = calibrated.camera
    values, vectors = np.linalg.eigh(calibrated.covariance)
    total = 0.0
    for value, vector in zip(values, vectors.T, strict=True):
        if value <= 0:
            continue
        step = np.sqrt(value) * vector
        K = camera.K.copy()
        K[[0, 1, 0, 1], [0, 1, 2, 2]] += step[:4]
        moved, _, _ = _distance(view, K, camera.distortion + step[4:])
        total += (moved - distance) ** 2
    return total
