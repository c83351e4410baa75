"""Cuts whose steps exceed those inside patches, softened by mixing the pixels on both sides."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from processing._synthesis.seam_steps import cut_steps
from processing._synthesis.strips import SheetRows

Float = npt.NDArray[np.float32]
Bytes = npt.NDArray[np.uint8]

# Rows of the part in the middle in which steps are measured, and rows that are softened at once.
_MEASURED, _ROWS = 1024, 512


def soften_cuts(sheet: SheetRows, labels: Bytes, *, wrapped: bool) -> None:
    """Make the mean step across cuts as large as that inside patches, if it is larger.

    A step of d between the two pixels at a straight cut becomes (1 - 2 s) d if each takes a share s
    of the other: if steps across cuts are a tenth larger, the share is .045.

    Parameters
    ----------
    sheet
        ``(H, W, 3)`` unit vectors, changed in place.
    labels
        ``(H, W)`` numbers of the patches.
    wrapped
        Whether the last column and row continue at the first.
    """
    height = len(labels)
    middle = slice(max(0, height - _MEASURED) // 2, max(0, height - _MEASURED) // 2 + _MEASURED)
    ratio = cut_steps(sheet[middle], labels[middle]).ratio
    if not ratio > 1:
        return
    share = (1 - 1 / ratio) / 2
    # Copies of rows that are replaced before they are read.
    top, above = sheet[:1].copy(), sheet[height - 1 : height].copy()
    for first in range(0, height, _ROWS):
        last = min(first + _ROWS, height)
        below = sheet[last : last + 1] if last < height else top
        rows = np.concatenate([above, sheet[first:last], below])
        numbers = np.take(labels, range(first - 1, last + 1), axis=0, mode="wrap")
        if not wrapped and first == 0:
            numbers[0] = numbers[1]
        if not wrapped and last == height:
            numbers[-1] = numbers[-2]
        above = rows[-2:-1]
        sheet[first:last] = _softened(rows, numbers, share, wrapped=wrapped)[1:-1]


def _softened(rows: Float, labels: Bytes, share: float, *, wrapped: bool) -> Float:
    """Return rows in which the pixels on both sides of a cut took a share of each other."""
    softened = rows.copy()
    for axis in (0, 1):
        # The first row and column have no neighbour before them, unless columns are wrapped.
        cut = labels != np.roll(labels, 1, axis)
        if axis == 0 or not wrapped:
            cut[(slice(None),) * axis + (0,)] = False
        here = np.nonzero(cut)
        before = (here[0] - 1, here[1]) if axis == 0 else (here[0], here[1] - 1)
        step = np.float32(share) * (rows[here] - rows[before])
        softened[here] -= step
        softened[before] += step
    return np.asarray(softened / np.linalg.norm(softened, axis=2, keepdims=True), np.float32)
