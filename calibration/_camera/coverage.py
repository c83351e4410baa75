"""How much of the field of view the corners of a calibration board covered."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibration._camera.view import BoardView

Mask = npt.NDArray[np.bool_]

_CELLS: Final = 60  # across the larger side of the image
_CORNER: Final = 1 / 6  # of a side of the image
_ENOUGH: Final = 0.25
_CORNERS: Final = {
    "upper left": (0, 0),
    "upper right": (0, -1),
    "lower left": (-1, 0),
    "lower right": (-1, -1),
}


def covered_field(views: Sequence[BoardView]) -> Mask:
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
    mask: Mask = covered > 0
    return mask


def bare_corners(covered: Mask) -> tuple[str, ...]:
    """Return the names of the corners of the image that are hardly covered."""
    rows, columns = (max(round(side * _CORNER), 1) for side in covered.shape)
    bare = []
    for name, (down, right) in _CORNERS.items():
        part = covered[:rows] if down == 0 else covered[-rows:]
        part = part[:, :columns] if right == 0 else part[:, -columns:]
        if part.mean() < _ENOUGH:
            bare.append(name)
    return tuple(bare)
