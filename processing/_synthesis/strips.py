"""Sheets of patches in strips of rows, so that only a part of a large sheet is in memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float32]
Bytes = npt.NDArray[np.uint8]
Whole = npt.NDArray[np.int32]

# Rows of patches of a strip: as many threads can place patches of one diagonal.
_ROWS = 16


class SheetRows(Protocol):
    """Rows of a sheet ``(H, W, 3)``, as an array or a file has them."""

    @property
    def shape(self) -> tuple[int, ...]:
        """(H, W, 3)."""

    def __getitem__(self, rows: slice, /) -> Float:
        """Return rows."""

    def __setitem__(self, rows: slice, values: Float, /) -> None:
        """Replace rows."""


@dataclass(frozen=True, eq=False)
class Strip:
    """A part of a sheet in which some rows of patches are placed.

    Parameters
    ----------
    first, last
        Range of the rows of patches.
    top
        First row of the sheet.
    sheet, labels
        ``(h, W, 3)`` and ``(h, W)``: what is there, then what was placed.
    """

    first: int
    last: int
    top: int
    sheet: Float
    labels: Bytes


def strips(
    sheet: SheetRows, labels: Bytes, tops: Whole, patch: int, *, wrapped: bool
) -> Iterator[Strip]:
    """Yield the strips of a sheet from the top downwards, and store each when it is filled.

    Parameters
    ----------
    sheet, labels
        Written.
    tops
        First row of the sheet of each row of patches.
    patch
        Side of the patches.
    wrapped
        The last row of patches overlaps the first one. It is a strip of its own, which continues
        with the first rows of the sheet.
    """
    height, width = labels.shape
    normals, numbers = np.zeros((0, width, 3), np.float32), np.zeros((0, width), np.uint8)
    count = len(tops) - wrapped
    starts = [*range(0, count, _ROWS), count] if wrapped else [*range(0, count, _ROWS)]
    for first, last in zip(starts, [*starts[1:], len(tops)], strict=True):
        top, bottom = int(tops[first]), int(tops[last - 1]) + patch
        around = max(bottom - height, 0) if wrapped else 0
        rows = min(bottom, height) + around - top
        part = Strip(
            first, last, top, np.zeros((rows, width, 3), np.float32),
            np.zeros((rows, width), np.uint8),
        )  # fmt: skip
        part.sheet[: len(normals)], part.labels[: len(numbers)] = normals, numbers
        if around:
            part.sheet[-around:], part.labels[-around:] = sheet[:around], labels[:around]
        yield part
        done = (int(tops[last]) if last < len(tops) else height) - top
        sheet[top : top + done] = part.sheet[:done]
        labels[top : top + done] = part.labels[:done]
        if around:
            sheet[:around], labels[:around] = part.sheet[-around:], part.labels[-around:]
        normals, numbers = part.sheet[done:], part.labels[done:]
