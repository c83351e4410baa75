"""Compiled placement of patches that follow a surface."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from processing._cuts.minimum_cuts import taken_pixels
from processing._synthesis.footprint_kernels import patch_map, sampled
from processing._synthesis.footprint_search import Places, Wanted, box_of, find_footprint, fitting
from processing._synthesis.patch_search import stream

# Compiled in: processing/_synthesis/footprint_kernels.py a31f4cd2cf9b
# Compiled in: processing/_synthesis/footprint_search.py f25e2e865c8d
# Compiled in: processing/_synthesis/patch_search.py f774940a9c88
# Compiled in: processing/_cuts/minimum_cuts.py f2a94c19d629
Float = npt.NDArray[np.float32]
Whole = npt.NDArray[np.int32]
Bytes = npt.NDArray[np.uint8]


@numba.njit(cache=True)
def _place(
    sheet: Float,
    labels: Bytes,
    steps: Float,
    turn: Float,
    patch: Whole,
    bands: tuple[int, int, int, int],
    size: int,
    places: Places,
    candidates: int,
    seed: int,
) -> tuple[int, float]:
    top, left = patch[2], patch[3]
    state = stream(seed, patch[0], patch[1])
    window = sheet[top : top + size, left : left + size]
    offsets, jacobian, turned = patch_map(
        steps[top : top + size, left : left + size], turn[top : top + size, left : left + size]
    )
    factor = fitting(offsets, places, size, candidates, state)
    for r in range(size):
        for c in range(size):
            for k in range(2):
                offsets[r, c, k] *= factor
                for m in range(2):
                    jacobian[r, c, k, m] *= factor
    count = size * size - (size - bands[0]) * (size - bands[1])
    wanted = Wanted(np.zeros((count, 2), np.float32), np.zeros(count, np.int32))
    columns, i = places.classes.shape[2], 0
    for r in range(size):
        for c in range(size):
            if c < bands[0] or r < bands[1]:
                cosine, sine = math.cos(turned[r, c]), math.sin(turned[r, c])
                wanted.slopes[i, 0] = cosine * window[r, c, 0] + sine * window[r, c, 1]
                wanted.slopes[i, 1] = cosine * window[r, c, 1] - sine * window[r, c, 0]
                down, right = math.floor(offsets[r, c, 0] + 0.5), math.floor(offsets[r, c, 1] + 0.5)
                wanted.offsets[i] = down * columns + right
                i += 1
    copy, y, x = find_footprint(wanted, box_of(offsets, 1.0), places, size, candidates, state)
    chosen = sampled(places.vectors[copy], y, x, offsets, jacobian, turned)
    new = taken_pixels(window, chosen, bands)
    # The numbers of patches that touch differ by at most 1 in row and column.
    label = np.uint8(patch[0] % 16 * 16 + patch[1] % 16)
    for r in range(size):
        for c in range(size):
            if new[r, c]:
                labels[top + r, left + c] = label
                for k in range(3):
                    window[r, c, k] = chosen[r, c, k]
    return int(places.classes[copy, y - size // 2, x - size // 2]), factor


@numba.njit(parallel=True, cache=True)
def place_warped(
    sheet: Float,
    labels: Bytes,
    steps: Float,
    turn: Float,
    patches: Whole,
    bands: Whole,
    size: int,
    places: Places,
    candidates: int,
    seed: int,
    used: Whole,
    factors: Float,
) -> None:
    """Place patches that touch no common pixel, in parallel.

    Parameters
    ----------
    sheet, labels
        ``(H, W, 3)`` and ``(H, W)``, written. All patches are inside.
    steps, turn
        The field, see `PatternField`.
    patches
        ``(n, 4)``: row and column in the grid, first row and column in the sheet.
    bands
        ``(n, 4)``: widths of the known parts of each patch: left, top, and 0, 0.
    size
        Side of a patch.
    places
        The exemplar.
    candidates, seed
        Number of random places; seed of the random numbers.
    used, factors
        ``(n,)``, written: classes of the places, and factors on the footprints.
    """
    for i in numba.prange(patches.shape[0]):
        known = (bands[i, 0], bands[i, 1], bands[i, 2], bands[i, 3])
        used[i], factors[i] = _place(
            sheet, labels, steps, turn, patches[i], known, size, places, candidates, seed
        )
