"""Least squares of intrinsics and poses over all views, with the covariance of the intrinsics.

Z. Zhang, A flexible new technique for camera calibration, 2000, as implemented in OpenCV. The
covariance is our own: it takes two residuals for each corner and all free parameters into account.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibration._errors import EstimateError
from calibration.camera.board import BoardView
from rig.arrays import Float64

# The intrinsic parameters, in the order of covariances.
PARAMETERS: Final = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
_FIXED: Final = {
    "k1": cv2.CALIB_FIX_K1,
    "k2": cv2.CALIB_FIX_K2,
    "p1": cv2.CALIB_ZERO_TANGENT_DIST,
    "k3": cv2.CALIB_FIX_K3,
}
_CRITERIA: Final = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 300, 1e-12)
# Focal lengths relative to the larger side of the image that are tried if the views give no start.
_STARTS: Final = (0.8, 1.6, 3.2)
_SINGULAR: Final = 1e-13
_POSE_PARAMETERS = 6


@dataclass(frozen=True, eq=False)
class Fit:
    """Intrinsics and poses.

    Parameters
    ----------
    K
        ``(3, 3)`` camera matrix.
    distortion
        ``(5,)`` coefficients k1, k2, p1, p2, k3; 0 for those that are not free.
    covariance
        ``(9, 9)`` of `PARAMETERS`; 0 for those that are not free. Infinite if the views do not
        determine the free ones.
    poses
        Rotation vector and translation of each view, ``(3,)`` each, in OpenCV's frame.
    residuals_px
        ``(n, 2)`` seen minus predicted corners of each view.
    sigma_px
        Standard deviation of a coordinate of a corner, from the residuals.
    """

    K: Float64
    distortion: Float64
    covariance: Float64
    poses: tuple[tuple[Float64, Float64], ...]
    residuals_px: tuple[Float64, ...]
    sigma_px: float

    def sigma(self, name: str) -> float:
        """Return the standard deviation of one of `PARAMETERS`."""
        k = PARAMETERS.index(name)
        return float(np.sqrt(self.covariance[k, k]))


def fit(views: Sequence[BoardView], free: Sequence[str]) -> Fit:
    """Fit K, the coefficients ``free`` of the distortion, and a pose for each view.

    Raises
    ------
    EstimateError
        If no camera explains the views.
    """
    height, width = views[0].size
    flags = sum(flag for name, flag in _FIXED.items() if name not in free)
    points = [view.points_mm.astype(np.float32) for view in views]
    seen = [view.corners_px.astype(np.float32)[:, None] for view in views]
    best = None
    for start in (None, *_STARTS):
        guess, more = None, 0
        if start is not None:
            f = start * max(width, height)
            guess = np.array([[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1]])
            more = cv2.CALIB_USE_INTRINSIC_GUESS
        try:
            rms, K, distortion, turns, shifts = cv2.calibrateCamera(
                points, seen, (width, height), guess, None, flags=flags | more, criteria=_CRITERIA
            )
        except cv2.error:
            continue
        if np.isfinite(K).all() and np.isfinite(distortion).all() and K[0, 0] > 0 < K[1, 1]:
            best = (K, distortion, turns, shifts) if np.isfinite(rms) else best
            break
    if best is None:
        raise EstimateError(
            "no camera explains the views of the calibration board: is it flat, and are all views "
            "taken with the same camera, zoom and focus?"
        )
    K, distortion, turns, shifts = best
    coefficients = np.asarray(distortion, np.float64).ravel()[:5]
    poses = tuple((_vector(r), _vector(t)) for r, t in zip(turns, shifts, strict=True))
    return _with_covariance(views, free, np.asarray(K, np.float64), coefficients, poses)


def projected(
    points_mm: Float64, pose: tuple[Float64, Float64], K: Float64, distortion: Float64
) -> tuple[Float64, Float64, Float64]:
    """Return pixels ``(n, 2)``, their derivatives by pose ``(2n, 6)`` and camera ``(2n, 9)``."""
    seen, derivatives = cv2.projectPoints(points_mm[:, None], *pose, K, distortion)
    jacobian = np.asarray(derivatives, np.float64)
    return np.asarray(seen, np.float64).reshape(-1, 2), jacobian[:, :6], jacobian[:, 6:15]


def _vector(values: npt.ArrayLike) -> Float64:
    return np.asarray(values, np.float64).ravel()


def _with_covariance(
    views: Sequence[BoardView],
    free: Sequence[str],
    K: Float64,
    distortion: Float64,
    poses: tuple[tuple[Float64, Float64], ...],
) -> Fit:
    used = np.array([name in free or name in PARAMETERS[:4] for name in PARAMETERS])
    residuals, normal = [], np.zeros((used.sum(), used.sum()))
    squares, count = 0.0, -int(used.sum())
    for view, pose in zip(views, poses, strict=True):
        predicted, by_pose, by_camera = projected(view.points_mm, pose, K, distortion)
        residual = view.corners_px - predicted
        residuals.append(residual)
        squares += float(np.sum(residual**2))
        count += residual.size - 6
        # The pose of the view is eliminated: what is left of the derivatives is orthogonal to it.
        inner = by_camera[:, used]
        basis, _ = np.linalg.qr(by_pose)
        inner = inner - basis @ (basis.T @ inner)
        normal += inner.T @ inner
    sigma2 = squares / max(count, 1)
    covariance = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    covariance[np.ix_(used, used)] = sigma2 * _inverse(normal)
    return Fit(K, distortion, covariance, poses, tuple(residuals), float(np.sqrt(sigma2)))


def _inverse(normal: Float64) -> Float64:
    """Return the inverse of normal equations, infinite if they are singular."""
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    values, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    if values[0] < _SINGULAR:
        return np.full(normal.shape, np.inf)
    return np.asarray((vectors / values) @ vectors.T / np.outer(scale, scale))


def pose_of(view: BoardView, K: Float64, distortion: Float64) -> tuple[Float64, Float64]:
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


def residual_pattern(views: Sequence[BoardView], residuals_px: Sequence[Float64]) -> float:
    """Return how much residuals follow a quadratic function of the place in each view.

    Parameters
    ----------
    views
        Views with their corners.
    residuals_px
        ``(n, 2)`` residuals of each view after a fit of camera and poses.

    Returns
    -------
    float
        Variance of the part that is quadratic over that of the rest, per degree of freedom: 1 for
        independent errors of the corners, more if the camera's model does not fit.
    """
    smooth = rest = 0.0
    freedom = [0, 0]
    for view, residual in zip(views, residuals_px, strict=True):
        places = view.corners_px - view.corners_px.mean(axis=0)
        x, y = (places / np.abs(places).max()).T
        basis, _ = np.linalg.qr(np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1))
        part = basis @ (basis.T @ residual)
        smooth += float(np.sum(part**2))
        rest += float(np.sum((residual - part) ** 2))
        # The pose of the view has removed six of the twelve coefficients.
        freedom[0] += 2 * basis.shape[1] - _POSE_PARAMETERS
        freedom[1] += residual.size - 2 * basis.shape[1]
    if freedom[1] <= 0 or rest == 0:
        return 1.0
    return (smooth / freedom[0]) / (rest / freedom[1])
