"""The correction of errors over long distances, on a coarse grid."""

from __future__ import annotations

import numpy as np

from processing.surface.blocks.plan import CELL
from processing.surface.grid_graph import label_parts
from processing.surface.multigrid import Levels, coarsened, solve
from processing.surface.multigrid_kernels import aggregate
from rig.arrays import Float32, Float64

_TOLERANCE = 1e-3


class CoarseGrid:
    """The weighted grid whose pixels are cells of 8 x 8 pixels of the image.

    Parameters
    ----------
    size
        Rows and columns of the image.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        rows, columns = (-(-side // CELL) for side in size)
        self._columns = size[1]
        self._right, self._down = np.zeros((2, rows + 2, columns + 2), np.float32)
        self._levels: Levels | None = None

    def add(self, top: int, right: Float32, down: Float32) -> None:
        """Add weights ``(h, W)`` of the edges of rows from ``top`` on, a multiple of the cell."""
        right, down = np.pad(right, 1), np.pad(down, 1)
        for _ in range(CELL.bit_length() - 1):
            right, down = aggregate(right, down)
        first = top // CELL + 1
        self._right[first : first + len(right) - 2] = right[1:-1]
        self._down[first : first + len(down) - 2] = down[1:-1]

    def correction(self, residuals: list[tuple[int, Float64]]) -> Float64:
        """Return the correction of the heights for residuals that are 0 elsewhere.

        Parameters
        ----------
        residuals
            First row, a multiple of the cell, and ``(h, W)`` residuals.

        Returns
        -------
        Double
            ``(rows, columns)`` of cells, NaN without edges; the mean over each connected part is 0.
        """
        if self._levels is None:
            self._levels = coarsened(self._right, self._down)
            self._labels, self._count = label_parts(self._right, self._down)
        b = np.zeros(self._right.shape)
        columns = range(0, self._columns, CELL)
        for top, residual in residuals:
            sums = np.add.reduceat(residual, range(0, len(residual), CELL), axis=0)
            sums = np.add.reduceat(sums, columns, axis=1)
            first = top // CELL + 1
            b[first : first + len(sums), 1:-1] += sums
        inside = self._labels >= 0
        members = self._labels[inside]
        sizes = np.bincount(members, minlength=self._count)
        b[~inside] = 0
        b[inside] -= (np.bincount(members, b[inside], self._count) / sizes)[members]
        u = solve(self._right, self._down, b, levels=self._levels, tolerance=_TOLERANCE).u
        found = np.full(u.shape, np.nan)
        found[inside] = u[inside] - (np.bincount(members, u[inside], self._count) / sizes)[members]
        return np.asarray(found[1:-1, 1:-1], np.float64)

    def row(self, correction: Float64, row: int) -> Float64:
        """Return the correction along a row of the image, interpolated between cells."""
        place = np.clip((row + 0.5) / CELL - 0.5, 0, len(correction) - 1)
        above = int(place)
        below, share = min(above + 1, len(correction) - 1), place - above
        known = np.isfinite(correction[[above, below]])
        values = np.where(known, correction[[above, below]], 0)
        weights = known * np.array([[1 - share], [share]])
        x = (np.arange(self._columns) + 0.5) / CELL - 0.5
        left = np.clip(np.floor(x).astype(int), 0, correction.shape[1] - 1)
        after = np.minimum(left + 1, correction.shape[1] - 1)
        part = np.clip(x - left, 0, 1)
        total, sums = (
            each[:, left] * (1 - part) + each[:, after] * part
            for each in (weights, weights * values)
        )
        total, sums = total.sum(axis=0), sums.sum(axis=0)
        return np.asarray(np.divide(sums, total, out=np.zeros_like(sums), where=total > 1e-6))
