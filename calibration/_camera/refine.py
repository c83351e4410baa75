"""Corners of a board to a hundredth of a pixel, in discs that reach no marker."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibration._camera.board import CharucoBoard
from calibration._camera.saddle import fit_saddles

Array = npt.NDArray[np.float64]
FloatImage = npt.NDArray[np.float32]

# Radius of the disc around a corner, in pixels. Smaller discs hold too few samples for the fit.
_SMALLEST_RADIUS, _LARGEST_RADIUS = 3.0, 10.0
_EDGE_BLUR_PX: Final = 1.0
_SMALLEST_WINDOW: Final = 2
_CRITERIA: Final = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-4)


def refined_corners(
    gray: FloatImage, board: CharucoBoard, ids: npt.NDArray[np.int64], starts_px: Array
) -> Array:
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


def _edges_and_gaps(
    board: CharucoBoard, ids: npt.NDArray[np.int64], starts_px: Array
) -> tuple[Array, Array]:
    """Return the directions of both edges at each corner, and the distance to a marker."""
    places = board.corners_mm[ids]
    plane, _ = cv2.findHomography(places, starts_px)
    if plane is None:
        return np.zeros_like(places), np.zeros(len(places))

    def seen(offset: tuple[float, float]) -> Array:
        moved = (places + offset)[:, None]
        return np.asarray(cv2.perspectiveTransform(moved, plane), np.float64)[:, 0]

    step = board.square_mm / 100
    along, down = seen((step, 0)) - seen((-step, 0)), seen((0, step)) - seen((0, -step))
    edges = np.stack([np.arctan2(part[:, 1], part[:, 0]) for part in (along, down)], axis=1)
    gap = (board.square_mm - float(board.marker_mm or 0)) / 2
    middle = seen((0, 0))
    diagonal = [seen((gap * i, gap * j)) - middle for i in (-1, 1) for j in (-1, 1)]
    return edges, np.linalg.norm(diagonal, axis=-1).min(axis=0)


def _by_gradients(gray: FloatImage, starts_px: Array) -> Array:
    """Refine corners of small squares: their discs would hold too few samples."""
    low, high = float(gray.min()), float(gray.max())
    scaled = (gray - np.float32(low)) / np.float32(max(high - low, 1e-12))
    window = (_SMALLEST_WINDOW, _SMALLEST_WINDOW)
    before = starts_px.astype(np.float32)[:, None]
    after = cv2.cornerSubPix(scaled, before.copy(), window, (-1, -1), _CRITERIA)
    found = np.asarray(after, np.float64)[:, 0]
    found[np.linalg.norm(found - starts_px, axis=1) > _SMALLEST_WINDOW] = np.nan
    return found
