"""Compiled placement of patches: search, minimum-error cuts, hard copy into the sheet."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from processing._cuts.minimum_cuts import taken_pixels
from processing._synthesis.patch_search import Bands, Double, Float, Whole, find_place, stream

# Compiled in: processing/_cuts/minimum_cuts.py 599a21c2471f
# Compiled in: processing/_synthesis/patch_search.py f774940a9c88
Bytes = npt.NDArray[np.uint8]


@numba.njit(cache=True)
def _place(
    sheet: Float,
    labels: Bytes,
    patch: Whole,
    bands: Bands,
    size: int,
    vectors: Float,
    slopes: Float,
    starts: Whole,
    classes: Whole,
    penalty: Double,
    mean_energy: float,
    candidates: int,
    seed: int,
) -> int:
    """Place one patch and return the class of its exemplar's patch; see `place_patches`."""
    rows, columns = labels.shape
    top, left = patch[2], patch[3]
    height = size if bands[3] else min(size, rows - top)
    width = size if bands[2] else min(size, columns - left)
    window = np.zeros((height, width, 3), np.float32)
    steep = np.zeros((height, 2 * width), np.float32)
    for r in range(height):
        for c in range(width):
            for k in range(3):
                window[r, c, k] = sheet[(top + r) % rows, (left + c) % columns, k]
            steep[r, 2 * c], steep[r, 2 * c + 1] = window[r, c, 0], window[r, c, 1]
    state = stream(seed, patch[0], patch[1])
    copy, y, x = find_place(
        steep, slopes, starts, classes, penalty, bands, mean_energy, candidates, state
    )
    chosen = vectors[copy, y : y + height, x : x + width]
    taken = taken_pixels(window, chosen, bands)
    # The numbers of patches that touch differ by at most 1 in row and column.
    label = np.uint8(patch[0] % 16 * 16 + patch[1] % 16)
    for r in range(height):
        for c in range(width):
            if taken[r, c]:
                q, d = (top + r) % rows, (left + c) % columns
                labels[q, d] = label
                for k in range(3):
                    sheet[q, d, k] = chosen[r, c, k]
    return int(classes[copy, y, x])


@numba.njit(nogil=True, cache=True)
def place_patches(
    first: int,
    last: int,
    sheet: Float,
    labels: Bytes,
    patches: Whole,
    bands: Whole,
    size: int,
    vectors: Float,
    slopes: Float,
    starts: Whole,
    classes: Whole,
    penalty: Double,
    mean_energy: float,
    candidates: int,
    seed: int,
    used: Whole,
) -> None:
    """Place patches that touch no common pixel, see `rig.in_threads`.

    Parameters
    ----------
    first, last
        Range of the patches to place.
    sheet, labels
        ``(H, W, 3)`` and ``(H, W)``, written.
    patches
        ``(n, 4)``: row and column in the grid, first row and column in the sheet. Windows that
        leave the sheet continue at its other side if they have a right or a bottom band.
    bands
        ``(n, 4)``: widths of the known parts of each window.
    size
        Side of a patch.
    vectors
        ``(copies, h, w, 3)`` normals of the exemplar and its copies.
    used
        ``(n,)``, written: classes of the places.

    For the others see `find_place`.
    """
    for i in range(first, last):
        known = (bands[i, 0], bands[i, 1], bands[i, 2], bands[i, 3])
        used[i] = _place(
            sheet, labels, patches[i], known, size, vectors, slopes, starts, classes, penalty,
            mean_energy, candidates, seed,
        )  # fmt: skip
