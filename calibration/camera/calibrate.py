"""Calibrate a camera from several views of a flat board."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from acquisition import CameraModel
from calibration._errors import DataError, EstimateError
from calibration.camera.board import BoardView, merge_same_places
from calibration.camera.board_search import FEWEST_CORNERS
from calibration.camera.fit import PARAMETERS, Fit, fit, pose_of, residual_pattern
from rig import Notice, Progress, no_progress, pluralize, short_repr
from rig.arrays import Bool, Float64

_FEWEST_VIEWS: Final = 3
# Coefficients of the distortion in the order in which they are left out, if they are within this
# many standard deviations of 0. Without k2 alone, k1 would be biased by many of its own.
_DOUBTFUL: Final = (("k3",), ("p1", "p2"), ("k1", "k2"))
_DETERMINED: Final = 3.0
# A view whose residuals are larger than those of all views by this factor contradicts them.
_INCONSISTENT: Final = 3.0
_OUTLIER: Final = 6.0
# Errors of corners that depend on the lens; residuals of this size are no contradiction.
_USUAL_PX: Final = 0.02
_MOST_LEFT_OUT: Final = 1 / 3
# Standard deviation of the focal length, relative to it.
_UNCERTAIN: Final = 0.002
_UNDETERMINED: Final = 0.01
_NOT_SQUARE: Final = 0.001
# Standard deviation of the corners, relative to the larger side of the image.
_UNEXPLAINED: Final = 0.001
# Variance of residuals that vary smoothly over a view, relative to that of the others.
_PATTERN: Final = 4.0
_GAUSSIAN_MAD: Final = 1.4826
_CELLS: Final = 60  # across the larger side of the image
_CORNER: Final = 1 / 6  # of a side of the image
_ENOUGH: Final = 0.25
_CORNERS: Final = {
    "upper left": (0, 0),
    "upper right": (0, -1),
    "lower left": (-1, 0),
    "lower right": (-1, -1),
}


def calibrate_camera(
    views: Sequence[BoardView], *, on_progress: Progress = no_progress
) -> CameraCalibration:
    """Estimate camera matrix and distortion from views of a calibration board.

    Minimises the distances between seen and predicted corners over the intrinsics and the pose of
    each view (Zhang, A flexible new technique for camera calibration, 2000). A coefficient of the
    distortion is kept if it differs from 0 by more than 3 standard deviations: k3 is tested first,
    then p1 and p2 together, then k1 and k2 together. Views that contradict the others, and outliers
    among the corners, are left out and reported. Views of the same place are one view.

    Parameters
    ----------
    views
        Views from `find_board`, of one board and with one camera, zoom and focus.
    on_progress
        Called with the stage and the number of fits.

    Returns
    -------
    CameraCalibration
        Camera, standard deviations, residuals and coverage.

    Raises
    ------
    DataError
        If the views differ in the size of their images or in their board.
    EstimateError
        If there are fewer than 3 places of the board, views contradict each other, or the views do
        not determine the focal length to 1 %, for instance because all are parallel.

    Examples
    --------
    >>> import numpy as np
    >>> from calibration import CharucoBoard, calibrate_camera, find_board
    >>> board = CharucoBoard(5, 4, 20)
    >>> view = find_board(board.in_opencv().generateImage((400, 320), marginSize=20), board)
    >>> try:
    ...     calibrate_camera([view, view])
    ... except ValueError as error:
    ...     print(str(error)[:54])
    1 view of the calibration board: at least 3 are needed
    """
    _check_alike(views)
    views, notices = merge_same_places(views)
    if len(views) < _FEWEST_VIEWS:
        raise EstimateError(
            f"{pluralize(len(views), 'view')} of the calibration board: at least {_FEWEST_VIEWS} "
            "are needed, better 15, with the board tilted by 20 to 45 degrees in different "
            "directions"
        )
    kept = _consistent(views, on_progress)
    parts = _parts(views, kept)
    best, free = _chosen(parts, on_progress)
    _check_explained(best, views[0].size)
    _check_determined(best)
    height, width = views[0].size
    camera = CameraModel(best.K, width, height, None, best.distortion)
    done = _calibrated_views(views, kept, best)
    covered = covered_field(parts)
    bare = bare_corners(covered)
    return CameraCalibration(
        camera,
        {name: best.sigma(name) for name in (*PARAMETERS[:4], *free)},
        best.covariance,
        best.sigma_px,
        done,
        covered,
        bare,
        (*notices, *_view_notices(done), *_doubts(best, bare), *_model_notices(parts, best)),
    )


def _check_alike(views: Sequence[BoardView]) -> None:
    for view in views:
        if view.size != views[0].size:
            (h, w), (height, width) = view.size, views[0].size
            raise DataError(
                f"{view.name}: {w} x {h} pixels, but {views[0].name} has {width} x {height}: "
                "give images of one camera at one resolution"
            )
        if view.board != views[0].board:
            raise DataError(f"{view.name}: shows another calibration board than {views[0].name}")


def _consistent(views: Sequence[BoardView], on_progress: Progress) -> list[Bool]:
    """Return which corners of each view agree with the others; a bad view has none."""
    kept = [np.ones(len(view.ids), np.bool_) for view in views]
    most = int(len(views) * _MOST_LEFT_OUT)
    for left_out in range(most + 1):
        on_progress("comparing the views", left_out, most + 1)
        used = [k for k, mask in enumerate(kept) if mask.any()]
        now = fit(_parts(views, kept), ("k1", "k2"))
        scatter = np.array([_scatter(residual) for residual in now.residuals_px])
        usual = float(np.median(scatter))
        worst = int(np.argmax(scatter))
        if scatter[worst] <= _INCONSISTENT * max(usual, _USUAL_PX):
            break
        if left_out == most or len(used) <= _FEWEST_VIEWS:
            name = views[used[worst]].name
            raise EstimateError(
                f"the views of the calibration board contradict each other, {name} most, by "
                f"{scatter[worst]:.2f} px: are camera, zoom and focus the same in all, "
                "and is the board flat?"
            )
        kept[used[worst]][:] = False
    on_progress("comparing the views", most + 1, most + 1)
    for k, residual in zip(used, now.residuals_px, strict=True):
        limit = _OUTLIER * max(now.sigma_px, _USUAL_PX)
        inside = np.linalg.norm(residual, axis=1) <= limit
        if inside.sum() >= FEWEST_CORNERS:
            kept[k][:] = inside
    return kept


def _scatter(residual: Float64) -> float:
    """Return a robust standard deviation of the residuals of a view."""
    length = np.median(np.abs(residual)) * _GAUSSIAN_MAD
    return float(max(length, np.sqrt(np.mean(residual**2)) / 2))


def _parts(views: Sequence[BoardView], kept: Sequence[Bool]) -> list[BoardView]:
    return [
        replace(view, ids=view.ids[mask], corners_px=view.corners_px[mask])
        for view, mask in zip(views, kept, strict=True)
        if mask.any()
    ]


def _chosen(parts: Sequence[BoardView], on_progress: Progress) -> tuple[Fit, list[str]]:
    """Return the fit with the coefficients of the distortion that are not 0, and their names."""
    free = ["k1", "k2", "p1", "p2", "k3"]
    for stage, names in enumerate(_DOUBTFUL):
        on_progress("fitting the camera", stage, len(_DOUBTFUL) + 1)
        now = fit(parts, free)
        if _differs_from_zero(now, names):
            break
        free = [name for name in free if name not in names]
    else:
        now = fit(parts, free)
    on_progress("fitting the camera", len(_DOUBTFUL) + 1, len(_DOUBTFUL) + 1)
    return now, free


def _differs_from_zero(now: Fit, names: Sequence[str]) -> bool:
    """Return whether one of the coefficients is further from 0 than their errors explain."""
    places = [PARAMETERS.index(name) for name in names]
    values = now.distortion[[place - 4 for place in places]]
    covariance = now.covariance[np.ix_(places, places)]
    if not np.isfinite(covariance).all():
        return False
    square = float(values @ np.linalg.solve(covariance, values))
    return square > _DETERMINED**2 * len(names)


def _check_explained(now: Fit, size: tuple[int, int]) -> None:
    if now.sigma_px > _UNEXPLAINED * max(size):
        raise EstimateError(
            f"no camera explains the views of the calibration board: its corners are "
            f"{now.sigma_px:.1f} px off; are camera, zoom and focus the same in all views, and is "
            "the board flat?"
        )


def _check_determined(now: Fit) -> None:
    share = max(now.sigma("fx") / now.K[0, 0], now.sigma("fy") / now.K[1, 1])
    if share <= _UNDETERMINED:
        return
    normals = np.array([cv2.Rodrigues(turn)[0][:, 2] for turn, _ in now.poses])
    crossed = np.linalg.norm(np.cross(normals[:, None], normals[None]), axis=-1)
    widest = np.degrees(np.arcsin(np.clip(crossed.max(), 0, 1)))
    size = f"{share:.1%}" if share < 1 else "more than 100 %"
    raise EstimateError(
        f"the views do not determine the focal length (standard deviation {size}); the board "
        f"was tilted by at most {widest:.0f} degrees between them: tilt it by 20 to 45 degrees "
        "in different directions"
    )


def _calibrated_views(
    views: Sequence[BoardView], kept: Sequence[Bool], best: Fit
) -> tuple[CalibratedView, ...]:
    poses = iter(best.poses)
    done = []
    for view, mask in zip(views, kept, strict=True):
        pose = next(poses) if mask.any() else pose_of(view, best.K, best.distortion)
        turn = cv2.Rodrigues(pose[0])[0]
        predicted, _ = cv2.projectPoints(view.points_mm, *pose, best.K, best.distortion)
        done.append(
            CalibratedView(
                view,
                mask,
                view.corners_px - np.asarray(predicted).reshape(-1, 2),
                float(np.degrees(np.arctan2(np.hypot(*turn[:2, 2]), abs(turn[2, 2])))),
                float((view.points_mm @ turn.T + pose[1])[:, 2].mean()),
            )
        )
    return tuple(done)


def _view_notices(views: Sequence[CalibratedView]) -> list[Notice]:
    notices = []
    usual = float(np.median([one.rms_px for one in views if one.used]))
    for one in views:
        outside = int((~one.kept).sum())
        if not one.used:
            text = (
                f"contradicts the other views ({one.rms_px:.2f} px, usually {usual:.2f} px) and is "
                "left out: did the board move or bend, or is the image blurred?"
            )
            notices.append(Notice("view-left-out", text, one.view.name))
        elif outside:
            text = f"{pluralize(outside, 'corner')} of {len(one.kept)} left out as outliers"
            notices.append(Notice("corners-left-out", text, one.view.name, "info"))
    return notices


def _model_notices(parts: Sequence[BoardView], best: Fit) -> list[Notice]:
    ratio = residual_pattern(parts, best.residuals_px)
    if ratio <= _PATTERN:
        return []
    text = (
        f"the residuals vary smoothly over the views, with {ratio:.0f} times the variance of "
        "independent errors, so the standard deviations are too small: did zoom or focus change, "
        "is the board not flat, or is the lens a fisheye?"
    )
    return [Notice("camera-model-doubtful", text)]


def _doubts(best: Fit, bare: Sequence[str]) -> list[Notice]:
    notices = []
    if bare:
        listed = " and ".join(filter(None, [", ".join(bare[:-1]), bare[-1]]))
        text = (
            f"no view covers the {listed} of the image: the distortion is extrapolated "
            "there; add views with the board there"
        )
        notices.append(Notice("field-not-covered", text))
    share = best.sigma("fx") / best.K[0, 0]
    if share > _UNCERTAIN:
        text = (
            f"the focal length has a standard deviation of {share:.2%}: add views with the board "
            "tilted by 20 to 45 degrees in different directions"
        )
        notices.append(Notice("focal-length-uncertain", text))
    ratio = best.K[0, 0] / best.K[1, 1] - 1
    variance = best.covariance[:2, :2] / np.outer(best.K[[0, 1], [0, 1]], best.K[[0, 1], [0, 1]])
    sigma = float(np.sqrt(max(variance[0, 0] + variance[1, 1] - 2 * variance[0, 1], 0)))
    if abs(ratio) > max(_NOT_SQUARE, 4 * sigma):
        text = (
            f"the pixels seem {abs(ratio):.2%} {'narrower' if ratio > 0 else 'wider'} than high: "
            "the print is probably stretched; measure its squares in both directions"
        )
        notices.append(Notice("pixels-not-square", text))
    return notices


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
    kept: Bool
    residuals_px: Float64
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
    covariance: Float64
    sigma_px: float
    views: tuple[CalibratedView, ...]
    covered: Bool
    bare_corners: tuple[str, ...]
    warnings: tuple[Notice, ...] = ()

    __repr__ = short_repr

    @property
    def coverage(self) -> float:
        """Share of the field of view that lies within the corners of a view, 0 to 1."""
        return float(self.covered.mean())


def covered_field(views: Sequence[BoardView]) -> Bool:
    """Return the cells of the field of view that lie within the corners of a view.

    Returns
    -------
    Mask
        ``(rows, columns)``, 60 square cells across the larger side of the image.
    """
    height, width = views[0].size
    cell = max(height, width) / _CELLS
    rows, columns = max(round(height / cell), 1), max(round(width / cell), 1)
    covered = np.zeros((rows, columns), np.uint8)
    scale = np.array([columns / width, rows / height])
    for view in views:
        places = ((view.corners_px + 0.5) * scale - 0.5).astype(np.float32)
        hull = cv2.convexHull(places).reshape(-1, 2)
        cv2.fillConvexPoly(covered, np.rint(hull).astype(np.int32), 1)
    return covered > 0


def bare_corners(covered: Bool) -> tuple[str, ...]:
    """Return the names of the corners of the image that are hardly covered."""
    rows, columns = (max(round(side * _CORNER), 1) for side in covered.shape)
    bare = []
    for name, (down, right) in _CORNERS.items():
        part = covered[:rows] if down == 0 else covered[-rows:]
        part = part[:, :columns] if right == 0 else part[:, -columns:]
        if part.mean() < _ENOUGH:
            bare.append(name)
    return tuple(bare)
