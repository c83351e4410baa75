"""Find the corners of a ChArUco board in an image, or say why the image has none."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np

from calibration._errors import DataError, EstimateError
from calibration.camera.board import DICTIONARIES, BoardView, CharucoBoard, dictionary_named
from calibration.camera.saddle_fit import fit_saddles
from calibration.radiance.demosaicing import luma
from rig import pluralize
from rig.arrays import Float32, Float64, Generic, Int64, UInt8

# A view with fewer corners hardly constrains its pose and the lens together.
FEWEST_CORNERS: Final = 8
_FEWEST_MARKERS: Final = 4
_SMALLEST_PX: Final = 32
# Corners further than this share of a square from a plane's perspective belong to another board.
_MISFIT: Final = 0.15
_LEAST_SQUARE_PX: Final = 8.0
# Radius of the disc around a corner, in pixels. Smaller discs hold too few samples for the fit.
_SMALLEST_RADIUS, _LARGEST_RADIUS = 3.0, 10.0
_EDGE_BLUR_PX: Final = 1.0
_SMALLEST_WINDOW: Final = 2
_CRITERIA: Final = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-4)


def find_board(image: Generic, board: CharucoBoard, name: str = "the image") -> BoardView:
    """Find the corners of a calibration board.

    Markers are found with OpenCV's ArUco detector (Garrido-Jurado et al., Automatic generation and
    detection of highly reliable fiducial markers under occlusion, 2014). The corners between them
    are refined in the samples as they are, so the image should be proportional to light.

    Parameters
    ----------
    image
        ``(H, W)`` or ``(H, W, 3)`` RGB, of any type and scale.
    board
        The board.
    name
        Name of the image, for messages.

    Returns
    -------
    BoardView
        At least 8 corners that are not on one line.

    Raises
    ------
    DataError
        If the array is not an image of at least 32 x 32 finite samples.
    EstimateError
        If the image does not show the board, or too little of it; the message says whether the
        board is mirrored, or another one.

    Examples
    --------
    >>> import numpy as np
    >>> from calibration import CharucoBoard, find_board
    >>> board = CharucoBoard(5, 4, 20)
    >>> picture = board.in_opencv().generateImage((400, 320), marginSize=20)
    >>> find_board(picture, board)
    BoardView(the image, 12 corners)
    """
    gray = _gray(image, name)
    shown = _eight_bits(gray)
    corners, ids = _markers(shown, board.dictionary)
    if len(ids) < _FEWEST_MARKERS:
        raise EstimateError(f"{name}: {_why_no_board(shown, board, len(ids))}")
    foreign = ids[ids >= board.markers]
    if len(foreign) > len(ids) // 4:
        raise EstimateError(
            f"{name}: marker {foreign.max()} is not on a calibration board of {_squares(board)}, "
            f"which has the markers 0 to {board.markers - 1}: give the board that was printed"
        )
    keep = np.flatnonzero(ids < board.markers)
    corners, ids = [corners[k] for k in keep], ids[keep]
    _check_fit(name, board, corners, ids)
    side = _square_px(board, corners)
    if side < _LEAST_SQUARE_PX:
        raise EstimateError(
            f"{name}: the squares of the calibration board have sides of {side:.1f} pixels, fewer "
            f"than {_LEAST_SQUARE_PX:g}: bring the board closer, or print larger squares"
        )
    which, places = _corners(gray, shown, board, corners, ids)
    count = len(which)
    if count < FEWEST_CORNERS:
        raise EstimateError(
            f"{name}: shows {pluralize(count, 'corner')} of the calibration board, fewer than "
            f"{FEWEST_CORNERS}: show more of it, sharp and evenly lit"
        )
    view = BoardView(name, board, (gray.shape[0], gray.shape[1]), which, places)
    if min(np.ptp(view.points_mm[:, axis]) for axis in (0, 1)) < board.square_mm / 2:
        raise EstimateError(
            f"{name}: all {count} corners are on one line of the calibration board: show more of it"
        )
    return view


def _gray(image: Generic, name: str) -> Float32:
    array = np.asarray(image)
    if array.ndim not in (2, 3) or (array.ndim == 3 and array.shape[2] != 3):
        raise DataError(f"{name}: an array of shape {array.shape} is not an image")
    if min(array.shape[:2]) < _SMALLEST_PX:
        raise DataError(
            f"{name}: {array.shape[1]} x {array.shape[0]} pixels are too few to show a board"
        )
    values = np.asarray(array, np.float32)
    if not np.isfinite(values).all():
        raise DataError(f"{name}: contains values that are not finite: replace them")
    return luma(values) if values.ndim == 3 else values


def _eight_bits(gray: Float32) -> UInt8:
    """Return an image for the detector of markers: stretched, with dark parts made brighter."""
    low, high = np.percentile(gray[::4, ::4], [0.5, 99.5])
    share = np.clip((gray - low) / max(float(high - low), 1e-12), 0, 1)
    return np.asarray(np.rint(255 * np.sqrt(share)), np.uint8)


def _markers(shown: UInt8, dictionary: str) -> tuple[list[Any], Int64]:
    detector = cv2.aruco.ArucoDetector(dictionary_named(dictionary))
    corners, ids, _ = detector.detectMarkers(shown)
    return list(corners), np.zeros(0, np.int64) if ids is None else ids.ravel().astype(np.int64)


def _why_no_board(shown: UInt8, board: CharucoBoard, count: int) -> str:
    """Return the reason why an image has few markers of a board: ``count`` of them."""
    _, ids = _markers(np.ascontiguousarray(shown[:, ::-1]), board.dictionary)
    if len(ids) > count + _FEWEST_MARKERS:
        return "the calibration board is mirrored: print it again, or do not mirror the images"
    for other in DICTIONARIES:
        if other.endswith("_250") and other[:3] != board.dictionary[:3]:
            _, ids = _markers(shown, other)
            if len(ids) > count + _FEWEST_MARKERS:
                return (
                    f"shows markers of {other[:3]} modules instead of {board.dictionary}: give the "
                    "board that was printed"
                )
    return (
        f"shows {pluralize(count, 'marker')} of the dictionary {board.dictionary}: show the board "
        "sharp and evenly lit"
    )


def _corners(
    gray: Float32, shown: UInt8, board: CharucoBoard, markers: list[Any], ids: Int64
) -> tuple[Int64, Float64]:
    """Return indices and places of the corners between the given markers."""
    detector = cv2.aruco.CharucoDetector(board.in_opencv())
    found, found_ids, _, _ = detector.detectBoard(
        shown, markerCorners=markers, markerIds=ids.astype(np.int32)[:, None]
    )
    which = np.zeros(0, np.int64) if found_ids is None else found_ids.ravel().astype(np.int64)
    if len(which) < FEWEST_CORNERS:
        return which, np.zeros((len(which), 2))
    places = refined_corners(gray, board, which, np.asarray(found, np.float64).reshape(-1, 2))
    good = np.isfinite(places[:, 0])
    return which[good], places[good]


def _check_fit(name: str, board: CharucoBoard, corners: list[Any], ids: Int64) -> None:
    """Refuse markers whose numbers are elsewhere on the board: it has another number of columns."""
    places = np.asarray(board.in_opencv().getObjPoints())[ids, :, :2].reshape(-1, 2)
    seen = np.asarray(corners, np.float64).reshape(-1, 2)
    mapped, _ = cv2.findHomography(places, seen, cv2.LMEDS)
    misfit = np.inf
    if mapped is not None:
        across = cv2.perspectiveTransform(places[:, None], mapped)[:, 0]
        misfit = float(np.quantile(np.linalg.norm(across - seen, axis=1), 0.8))
    if misfit > _MISFIT * _square_px(board, corners):
        raise EstimateError(
            f"{name}: the markers are in another order than on a calibration board of "
            f"{_squares(board)}: give the numbers of squares of the board that was printed"
        )


def _square_px(board: CharucoBoard, corners: list[Any]) -> float:
    """Return the median side of the squares in the image."""
    sides = np.asarray(corners, np.float64).reshape(-1, 4, 2)
    length = np.linalg.norm(sides - np.roll(sides, 1, axis=1), axis=-1).mean(axis=1)
    return float(np.median(length)) * board.square_mm / float(board.marker_mm or 1)


def _squares(board: CharucoBoard) -> str:
    return f"{board.columns} x {board.rows} squares"


def refined_corners(gray: Float32, board: CharucoBoard, ids: Int64, starts_px: Float64) -> Float64:
    """Return ``(n, 2)`` corners of a board; NaN where the image does not determine one.

    Parameters
    ----------
    gray
        ``(H, W)`` image that is proportional to light.
    board
        The board.
    ids
        ``(n,)`` indices into `CharucoBoard.corners_mm`, at least 4 that are not on one line.
    starts_px
        ``(n, 2)`` corners to about a pixel.
    """
    edges, gaps = _edges_and_gaps(board, ids, starts_px)
    height, width = gray.shape
    to_border = np.minimum(starts_px, np.array([width - 1, height - 1]) - starts_px).min(axis=1)
    radii = np.minimum(gaps - _EDGE_BLUR_PX, to_border).clip(max=_LARGEST_RADIUS)
    found = np.full(starts_px.shape, np.nan)
    wide = radii >= _SMALLEST_RADIUS
    if wide.any():
        found[wide] = fit_saddles(gray, starts_px[wide], edges[wide], radii[wide])
    narrow = ~wide & (to_border >= _SMALLEST_WINDOW)
    if narrow.any():
        found[narrow] = _by_gradients(gray, starts_px[narrow])
    return found


def _edges_and_gaps(board: CharucoBoard, ids: Int64, starts_px: Float64) -> tuple[Float64, Float64]:
    """Return the directions of both edges at each corner, and the distance to a marker."""
    places = board.corners_mm[ids]
    plane, _ = cv2.findHomography(places, starts_px)
    if plane is None:
        return np.zeros_like(places), np.zeros(len(places))

    def seen(offset: tuple[float, float]) -> Float64:
        moved = (places + offset)[:, None]
        return np.asarray(cv2.perspectiveTransform(moved, plane), np.float64)[:, 0]

    step = board.square_mm / 100
    along, down = seen((step, 0)) - seen((-step, 0)), seen((0, step)) - seen((0, -step))
    edges = np.stack([np.arctan2(part[:, 1], part[:, 0]) for part in (along, down)], axis=1)
    gap = (board.square_mm - float(board.marker_mm or 0)) / 2
    middle = seen((0, 0))
    diagonal = [seen((gap * i, gap * j)) - middle for i in (-1, 1) for j in (-1, 1)]
    return edges, np.linalg.norm(diagonal, axis=-1).min(axis=0)


def _by_gradients(gray: Float32, starts_px: Float64) -> Float64:
    """Refine corners of small squares: their discs would hold too few samples."""
    low, high = float(gray.min()), float(gray.max())
    scaled = (gray - np.float32(low)) / np.float32(max(high - low, 1e-12))
    window = (_SMALLEST_WINDOW, _SMALLEST_WINDOW)
    before = starts_px.astype(np.float32)[:, None]
    after = cv2.cornerSubPix(scaled, before.copy(), window, (-1, -1), _CRITERIA)
    found = np.asarray(after, np.float64)[:, 0]
    found[np.linalg.norm(found - starts_px, axis=1) > _SMALLEST_WINDOW] = np.nan
    return found
