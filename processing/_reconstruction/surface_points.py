"""Points of a surface under near lights, computed for the rows that are used."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from processing._reconstruction.views import View

Double = npt.NDArray[np.float64]
Rows = slice | npt.NDArray[np.intp]


class SurfacePoints(NamedTuple):
    """Surface points ``(H, W, 3)`` in mm, of which only rows are in memory.

    Parameters
    ----------
    view
        How the pixels see points.
    depth
        ``(H, W)`` depths, or one of all pixels.
    size
        ``(H, W)``.
    """

    view: View
    depth: npt.NDArray[np.float32] | float
    size: tuple[int, ...]

    def of(self, rows: Rows = slice(None)) -> Double:
        """Return the points ``(R, W, 3)`` of some rows."""
        numbers = np.arange(self.size[0])[rows]
        depth = self.depth if isinstance(self.depth, float) else self.depth[rows]
        return self.view.points_of(numbers, depth)

    def at(self, pixels: npt.NDArray[np.intp]) -> Double:
        """Return the points ``(P, 3)`` of pixels, indices into the flat image."""
        rows, columns = np.divmod(pixels, self.size[1])
        found = [self.of(np.array([row]))[0, columns[rows == row]] for row in np.unique(rows)]
        return np.concatenate(found)
