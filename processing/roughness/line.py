"""Heights along a line across a map."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from acquisition import DataError
from rig import pluralize
from rig.arrays import Float64, Floating

_FEWEST = 16


@dataclass(frozen=True)
class Line:
    """A line in an image, from one place to another.

    Parameters
    ----------
    x0, y0, x1, y1
        Column and row of both ends, in pixels; the middle of the first pixel is (0, 0).
    width
        Number of parallel lines, one pixel apart, whose mean counts.
    """

    x0: float
    y0: float
    x1: float
    y1: float
    width: int = 1

    @property
    def length_px(self) -> float:
        """Length in pixels."""
        return math.hypot(self.x1 - self.x0, self.y1 - self.y0)

    def __str__(self) -> str:
        ends = ",".join(f"{value:g}" for value in (self.x0, self.y0, self.x1, self.y1))
        return ends if self.width == 1 else f"{ends},{self.width}"

    def window(self, shape: tuple[int, ...], margin: int) -> tuple[slice, slice]:
        """Return rows and columns around the line, with a margin."""
        reach = margin + self.width // 2 + 2
        return tuple(  # type: ignore[return-value]
            slice(max(int(min(ends)) - reach, 0), min(int(max(ends)) + reach + 1, size))
            for ends, size in zip(((self.y0, self.y1), (self.x0, self.x1)), shape, strict=True)
        )

    def moved(self, window: tuple[slice, slice]) -> Line:
        """Return the same line in a window of the image."""
        y, x = window[0].start, window[1].start
        return Line(self.x0 - x, self.y0 - y, self.x1 - x, self.y1 - y, self.width)

    def of(self, heights: Floating) -> Float64:
        """Return the heights along the line, ``(N,)`` float64, one per pixel of its length.

        Between pixels they are interpolated by cubic convolution; NaN where one of the pixels is
        not known.

        Raises
        ------
        DataError
            If the line leaves the image or is too short.
        """
        height, width = heights.shape
        count = int(self.length_px) + 1
        if count < _FEWEST:
            raise DataError(f"{pluralize(count, 'pixel')} long, too short: use {_FEWEST} or more")
        along = np.array([self.x1 - self.x0, self.y1 - self.y0]) / self.length_px
        apart = (np.arange(self.width) - (self.width - 1) / 2)[:, None]
        x = self.x0 + along[0] * np.arange(count) - along[1] * apart
        y = self.y0 + along[1] * np.arange(count) + along[0] * apart
        edge = 1e-6
        if max(-x.min(), -y.min(), x.max() - width + 1, y.max() - height + 1) > edge:
            raise DataError(
                f"leaves the image of {width} x {height} pixels, whose last pixel is "
                f"{width - 1},{height - 1}"
            )
        found = np.asarray(
            cv2.remap(
                heights.astype(np.float32, copy=False),
                x.astype(np.float32),
                y.astype(np.float32),
                cv2.INTER_CUBIC,
                borderMode=cv2.BORDER_REPLICATE,
            ),
            np.float64,
        )
        # Cubic convolution takes a pixel next to an unknown one for unknown.
        near_x, near_y = np.round(x), np.round(y)
        whole = (np.abs(near_x - x) < edge) & (np.abs(near_y - y) < edge)
        found[whole] = heights[near_y[whole].astype(int), near_x[whole].astype(int)]
        return np.asarray(found.mean(axis=0))
