"""The part of an image that pictures of one object show, and its reduction to a picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

import acquisition
from rig.arrays import AnyArray, Bool, Float32, Intp

_MOST_PX: Final = 700  # of a side of a picture: about twice the pixels of a slot
_BAND: Final = 64  # rows


@dataclass(frozen=True)
class Crop:
    """A rectangle of an image.

    Parameters
    ----------
    rows, columns
        The rectangle.
    pixel_mm
        Size of a pixel on the object in mm; None if it is not known.
    most_px
        Longest side of its pictures; larger ones are reduced.
    """

    rows: slice
    columns: slice
    pixel_mm: float | None = None
    most_px: float = _MOST_PX

    @classmethod
    def whole(cls, image: AnyArray) -> Crop:
        """Return the full image."""
        return cls(slice(0, image.shape[0]), slice(0, image.shape[1]))

    @classmethod
    def around(cls, mask: Bool, pixel_mm: float | None = None) -> Crop:
        """Return the rectangle that contains a mask and a margin; the full image if it is empty."""
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        if not len(rows):
            rows, columns = (np.arange(count) for count in mask.shape)
        margin = 2 + max(np.ptp(rows), np.ptp(columns)) // 50
        return cls(
            _with_margin(rows, int(margin), mask.shape[0]),
            _with_margin(columns, int(margin), mask.shape[1]),
            pixel_mm,
        )

    @property
    def size(self) -> tuple[int, int]:
        """Number of rows and columns."""
        return self.rows.stop - self.rows.start, self.columns.stop - self.columns.start

    @property
    def aspect(self) -> float:
        """Width divided by height."""
        return self.size[1] / self.size[0]

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top of the picture in pixels of the image, for ``imshow``."""
        return (
            self.columns.start - 0.5,
            self.columns.stop - 0.5,
            self.rows.stop - 0.5,
            self.rows.start - 0.5,
        )

    @property
    def step(self) -> float:
        """Number of pixels of the image per pixel of the picture."""
        return max(1.0, max(self.size) / self.most_px)

    def picture(self, values: AnyArray | acquisition.MapRows, mask: Bool | None = None) -> Float32:
        """Cut out a map or an image, ``(H, W)`` or ``(H, W, 3)``, and reduce it.

        Pixels are averaged; NaN and pixels outside the mask are left out. A pixel of the picture is
        NaN if most of its pixels are.
        """
        rows, columns = (max(1, round(side / self.step)) for side in self.size)
        shares, totals = [], []
        # First across, in bands of rows: the copies of a complete map would take much memory.
        for top in range(self.rows.start, self.rows.stop, _BAND):
            band = slice(top, min(top + _BAND, self.rows.stop))
            part = values[band][:, self.columns].astype(np.float32)
            known = np.isfinite(part)
            if mask is not None:
                inside = mask[band, self.columns]
                known &= inside if part.ndim == 2 else inside[..., None]
            if self.step == 1.0:
                if mask is not None:
                    part[~known] = np.nan
                totals.append(part)
                continue
            part[~known] = 0
            shares.append(_mean(known.astype(np.float32), columns, len(part)))
            totals.append(_mean(part, columns, len(part)))
        if self.step == 1.0:
            return np.concatenate(totals)
        share, total = (_mean(np.concatenate(bands), columns, rows) for bands in (shares, totals))
        return np.where(share > 0.5, total / np.maximum(share, 1e-6), np.nan).astype(np.float32)


def _mean(image: Float32, columns: int, rows: int) -> Float32:
    reduced = cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(reduced, np.float32).reshape(rows, columns, *image.shape[2:])


def _with_margin(places: Intp, margin: int, count: int) -> slice:
    return slice(max(int(places[0]) - margin, 0), min(int(places[-1]) + 1 + margin, count))
