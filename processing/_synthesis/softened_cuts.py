"""Cuts whose steps exceed those inside patches, softened by mixing the pixels on both sides."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from acquisition import MapRows
from processing._synthesis.seam_steps import cut_steps, part_in_middle
from processing._synthesis.strips import bands_with_margins

Float = npt.NDArray[np.float32]
Bytes = npt.NDArray[np.uint8]

# Rows of the part in the middle in which steps are measured.
_MEASURED = 1024


def softening_share(sheet: MapRows, labels: MapRows) -> float:
    """Return the share that the pixels at a cut take of each other; 0 if none is needed.

    It makes the mean step across cuts as large as that inside patches. A step of d between the two
    pixels at a straight cut becomes (1 - 2 s) d if each takes a share s of the other: if steps
    across cuts are a tenth larger, the share is 0.045.

    Parameters
    ----------
    sheet
        ``(H, W, 3)`` unit vectors.
    labels
        ``(H, W)`` numbers of the patches.
    """
    height = labels.shape[0]
    middle = slice(max(0, height - _MEASURED) // 2, max(0, height - _MEASURED) // 2 + _MEASURED)
    ratio = cut_steps(part_in_middle(sheet, middle), part_in_middle(labels, middle)).ratio
    return (1 - 1 / ratio) / 2 if ratio > 1 else 0.0


def softened_bands(
    sheet: MapRows, labels: MapRows, share: float, *, wrapped: bool, begin: int = 0
) -> Iterator[tuple[slice, Float]]:
    """Yield bands of rows whose cuts are softened, beginning with a band."""
    height = labels.shape[0]
    for rows, band in bands_with_margins(sheet, 1, wrapped=wrapped, begin=begin):
        first, last = rows.start, rows.stop
        before = labels[first - 1 : first] if first else labels[height - 1 : height]
        after = labels[last : last + 1] if last < height else labels[:1]
        numbers = np.concatenate([before, labels[rows], after])
        if not wrapped and first == 0:
            numbers[0] = numbers[1]
        if not wrapped and last == height:
            numbers[-1] = numbers[-2]
        yield rows, _softened(band, numbers, share, wrapped=wrapped)[1:-1]


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
