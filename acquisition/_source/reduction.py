"""Region and resolution at which the frames of a source are used."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

Sample = TypeVar("Sample", bound=np.generic)


@dataclass(frozen=True)
class Reduction:
    """A region of frames, and the number of pixels per axis that become one.

    Parameters
    ----------
    x, y
        Column and row of the region's first pixel in a frame.
    width, height
        Size of the region in pixels of a frame. Columns on the right and rows at the bottom that do
        not fill a block of ``factor x factor`` pixels are not used.
    factor
        Pixels per axis that are averaged, at least 1.
    """

    x: int
    y: int
    width: int
    height: int
    factor: int = 1

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the reduced image."""
        return self.height // self.factor, self.width // self.factor

    def cut(self, image: npt.NDArray[Sample]) -> npt.NDArray[Sample]:
        """Return the used part of an image ``(H, W, ...)`` of a frame's size, as a view."""
        height, width = self.size
        rows = slice(self.y, self.y + height * self.factor)
        return image[rows, self.x : self.x + width * self.factor]

    def blocks(self, image: npt.NDArray[Sample]) -> list[npt.NDArray[Sample]]:
        """Return the ``factor^2`` views that contain one pixel of each block."""
        part, step = self.cut(image), self.factor
        return [part[row::step, column::step] for row in range(step) for column in range(step)]

    def mean(self, image: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Return the average of each block, NaN if a sample of the block is NaN.

        Parameters
        ----------
        image
            ``(H, W)`` or ``(H, W, 3)`` linear values of a frame's size.

        Returns
        -------
        npt.NDArray[np.float32]
            Image of `size`; a copy.
        """
        first, *others = self.blocks(image)
        total = first.copy()
        for block in others:
            total += block
        return total if not others else np.divide(total, np.float32(1 + len(others)), out=total)

    def all(self, mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Return where all pixels of a block are True, ``(H, W)`` of `size`."""
        first, *others = self.blocks(mask)
        every = first.copy()
        for block in others:
            every &= block
        return every
