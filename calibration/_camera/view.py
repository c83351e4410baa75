"""One view of a calibration board: which corners are where in the image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calibration._camera.board import CharucoBoard
from rig import pluralize

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BoardView:
    """Corners of a calibration board in one image.

    Parameters
    ----------
    name
        Name of the image, for messages.
    board
        The board that was found.
    size
        (height, width) of the image.
    ids
        ``(n,)`` indices into `CharucoBoard.corners_mm`.
    corners_px
        ``(n, 2)`` positions (x, y) in the image; the centre of the first pixel is at (0, 0).
    """

    name: str
    board: CharucoBoard
    size: tuple[int, int]
    ids: npt.NDArray[np.int64]
    corners_px: Array

    def __repr__(self) -> str:
        return f"BoardView({self.name}, {pluralize(len(self.ids), 'corner')})"

    @property
    def points_mm(self) -> Array:
        """``(n, 3)`` the same corners on the board, with z = 0."""
        points: Array = np.pad(self.board.corners_mm[self.ids], ((0, 0), (0, 1)))
        return points
