"""Pixels of a frame by colour, and means over blocks of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from rig.arrays import Bool, Float64, Floating

Sample = TypeVar("Sample", bound=np.generic)


@dataclass(frozen=True)
class Sites:
    """Where a frame shows which colour.

    Parameters
    ----------
    shape
        ``(H, W)`` or ``(H, W, 3)`` of the frames.
    cfa
        Colours of the first 2 x 2 pixels of a mosaic, row by row; None for other frames.
    """

    shape: tuple[int, ...]
    cfa: str | None

    @property
    def colours(self) -> int:
        """Number of colours: 1 or 3."""
        return 1 if self.cfa is None and len(self.shape) == 2 else 3

    def of_pixels(self, of_colours: npt.ArrayLike, rows: slice = slice(None)) -> Float64:
        """Return values per colour, ``(..., C)``, at each pixel of some rows.

        Returns
        -------
        NDArray
            ``(..., rows, W)``, or for frames in colour something that broadcasts against
            ``(..., rows, W, 3)``.
        """
        values = np.asarray(of_colours, np.float64)
        if len(self.shape) == 3:
            return values[..., None, None, :]
        if self.cfa is None:
            return values[..., 0][..., None, None]
        height, width = self.shape
        order = ["RGB".index(name) for name in self.cfa]
        tile = values[..., order].reshape(*values.shape[:-1], 2, 2)
        at = np.arange(*rows.indices(height)) % 2
        return tile[..., at, :][..., np.arange(width) % 2]

    def colour(self, image: npt.NDArray[Sample], colour: int) -> npt.NDArray[Sample]:
        """Return the plane of a colour of a frame; of a mosaic, all sites."""
        return image[..., colour] if len(self.shape) == 3 else image

    def has(self, colour: int) -> Bool:
        """Return the pixels ``(H, W)`` that show a colour."""
        height, width = self.shape[:2]
        if self.cfa is None:
            return np.ones((height, width), np.bool_)
        tile = np.array([name == "RGB"[colour] for name in self.cfa]).reshape(2, 2)
        return np.tile(tile, (-(-height // 2), -(-width // 2)))[:height, :width]


def block_means(values: Floating, where: Bool, side: int) -> Float64:
    """Return the means of values ``(H, W)`` over blocks, NaN where less than half is True."""
    rows, columns = values.shape[0] // side, values.shape[1] // side
    cut = slice(0, rows * side), slice(0, columns * side)
    shape = (rows, side, columns, side)
    count = where[cut].reshape(shape).sum(axis=(1, 3))
    total = np.where(where, values, 0.0)[cut].reshape(shape).sum(axis=(1, 3), dtype=np.float64)
    least = max(1, int(count.max()) // 2)
    return np.where(count >= least, total / np.maximum(count, 1), np.nan)
