"""Compiled placement of patches that follow a surface."""

from __future__ import annotations

import math

import numba
import numpy as np

from processing.detail.minimum_cuts import taken_pixels
from processing.synthesis.footprint_kernels import patch_map, sampled
from processing.synthesis.footprint_search import Places, Wanted, box_of, find_footprint, fitting
from processing.synthesis.patch_search import stream
from rig.arrays import Float32, Int32, UInt8
from rig.kernels import INLINED

# Compiled in: processing/detail/minimum_cuts.py 595407bbeb71
# Compiled in: processing/synthesis/footprint_kernels.py dd7033e3eaec
# Compiled in: processing/synthesis/footprint_search.py cbd51caeed44
# Compiled in: processing/synthesis/patch_search.py 1d7cb504f7ac
# Compiled in: rig/kernels/parts.py 986f6e8c38a7

# A guide is compared at this many rows and columns of a patch.
_GUIDE_SAMPLES = 6


@numba.njit(**INLINED)
def _place(
    sheet: Float32,
    labels: UInt8,
    steps: Float32,
    turn: Float32,
    guide: Float32,
    patch: Int32,
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
    stride = max(size // _GUIDE_SAMPLES, 1)
    samples = len(range(stride // 2, size, stride)) if guide.size else 0
    wanted = Wanted(
        np.zeros((count, 2), np.float32),
        np.zeros(count, np.int32),
        np.zeros(samples * samples, np.float32),
        np.zeros(samples * samples, np.int32),
    )
    columns, i = places.classes.shape[2], 0
    for r in range(samples):
        for c in range(samples):
            q, d = stride // 2 + r * stride, stride // 2 + c * stride
            down, right = math.floor(offsets[q, d, 0] + 0.5), math.floor(offsets[q, d, 1] + 0.5)
            wanted.guide[r * samples + c] = guide[top + q, left + d]
            wanted.guide_offsets[r * samples + c] = down * columns + right
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


@numba.njit(nogil=True, cache=True)
def place_warped(
    first: int,
    last: int,
    sheet: Float32,
    labels: UInt8,
    steps: Float32,
    turn: Float32,
    guide: Float32,
    patches: Int32,
    bands: Int32,
    size: int,
    places: Places,
    candidates: int,
    seed: int,
    used: Int32,
    factors: Float32,
) -> None:
    """Place patches that touch no common pixel, see `rig.in_threads`.

    Parameters
    ----------
    first, last
        Range of the patches to place.
    sheet, labels
        ``(H, W, 3)`` and ``(H, W)``, written. All patches are inside.
    steps, turn
        The field, see `PatternField`.
    guide
        ``(H, W)`` in the unit of the guide of the exemplar, or ``(0, 0)`` without guidance.
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
    for i in range(first, last):
        known = (bands[i, 0], bands[i, 1], bands[i, 2], bands[i, 3])
        used[i], factors[i] = _place(
            sheet, labels, steps, turn, guide, patches[i], known, size, places, candidates, seed
        )
