"""Images moved by parts of a pixel, row by row."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final, NamedTuple

import cv2
import numpy as np

from acquisition.comparison import lanczos
from rig.arrays import AnyArray, Float32

# Rows and columns that the interpolation needs on each side.
_REACH: Final = 5


# Many parts of an image have the same shift.
_weights = lru_cache(maxsize=128)(lanczos)


class Shift(NamedTuple):
    """By how much the object is further right and down in an image, in pixels."""

    right: float
    down: float

    def rows(self, wanted: slice, height: int) -> slice:
        """Return the rows of an image from which the wanted ones are made."""
        first = math.floor(wanted.start + self.down) - _REACH
        last = math.ceil(wanted.stop + self.down) + _REACH
        start = min(max(first, 0), height - 1)
        return slice(start, max(start + 1, min(last, height)))

    @property
    def noise(self) -> float:
        """Variance of interpolated samples relative to that of the samples themselves."""
        return math.prod(float((lanczos(part % 1) ** 2).sum()) for part in self)

    def moved(self, image: Float32, top: int, wanted: slice) -> Float32:
        """Return the wanted rows of an image at the position of the others.

        Parameters
        ----------
        image
            ``(h, W)`` or ``(h, W, C)``: the rows that `rows` names; NaN where missing.
        top
            The first of them.
        wanted
            Rows to return.

        Returns
        -------
        Float32
            NaN next to missing samples, and outside the image.
        """
        whole = math.floor(self.right), math.floor(self.down)
        missing = ~np.isfinite(image)
        if some := missing.any():
            # A missing sample is bright.
            bright = float(np.nanmax(image)) if not missing.all() else 0.0
            image = np.where(missing, np.float32(bright), image)
        right, down = (_weights(part % 1) for part in self)
        made = cv2.sepFilter2D(image, cv2.CV_32F, right, down, borderType=cv2.BORDER_REPLICATE)
        made = made.reshape(image.shape)
        if some:
            gone = cv2.dilate(missing.astype(np.uint8), np.ones((3, 3), np.uint8))
            made[gone.reshape(image.shape) > 0] = np.nan
        return self._placed(made, top, wanted, whole, np.float32(np.nan))

    def whole(self, values: AnyArray, top: int, wanted: slice) -> AnyArray:
        """Return the wanted rows of values that have no mean, moved by whole pixels; 0 outside."""
        by = round(self.right), round(self.down)
        return self._placed(values, top, wanted, by, values.dtype.type(0))

    @staticmethod
    def _placed(
        values: AnyArray, top: int, wanted: slice, by: tuple[int, int], outside: object
    ) -> AnyArray:
        right, down = by
        height, width = values.shape[:2]
        placed = np.full((wanted.stop - wanted.start, *values.shape[1:]), outside, values.dtype)
        first = wanted.start + down - top
        above, before = max(0, -first), max(0, -right)
        below, beside = min(len(placed), height - first), min(width, width - right)
        if above < below and before < beside:
            seen = values[above + first : below + first, before + right : beside + right]
            placed[above:below, before:beside] = seen
        return placed
