"""Compiled placement of patches into holes of any form."""

from __future__ import annotations

import numba
import numpy as np

from processing.detail.minimum_cuts import taken_pixels
from processing.synthesis.patch_search import stream
from rig.arrays import Float32, Float64, Int32, UInt8
from rig.kernels import INLINED, PART

# Compiled in: processing/detail/minimum_cuts.py 595407bbeb71
# Compiled in: processing/synthesis/patch_search.py 1d7cb504f7ac
# Compiled in: rig/kernels/parts.py 986f6e8c38a7

_FAST = {"contract", "reassoc"}
# States of pixels; 0 is outside the object.
HOLE, KNOWN, MADE = 1, 2, 3
# The share of the mean energy in the denominator of the cost, as in `patch_search`.
_GROUND = 0.5
_REFINED = 4
_COARSE = 5
_STEPS = (4, 2, 1, 1)


@numba.njit(**PART)
def _compared(state: UInt8, top: int, left: int, side: int, band: int) -> Int32:
    """Return the rows and columns in a window of the pixels that a patch must continue.

    They have a vector, and are at most `band` rows and columns away from a pixel of a hole.
    """
    near = np.zeros((side, side), np.bool_)
    # The largest over rows, then over columns.
    for r in range(side):
        last = -side
        for c in range(side):
            if state[top + r, left + c] == HOLE:
                for t in range(max(last + band + 1, c - band, 0), min(c + band + 1, side)):
                    near[r, t] = True
                last = c
    found = np.zeros((side * side, 2), np.int32)
    count = 0
    for c in range(side):
        for r in range(side):
            if state[top + r, left + c] < KNOWN:
                continue
            for t in range(max(r - band, 0), min(r + band + 1, side)):
                if near[t, c]:
                    found[count, 0], found[count, 1] = r, c
                    count += 1
                    break
    return found[:count]


@numba.njit(**INLINED, fastmath=_FAST, error_model="numpy")
def _cost(
    pixels: Int32, there: Float32, slopes: Float32, y: int, x: int, ground: float, step: int
) -> float:
    """Return the cost of continuing the compared pixels by the patch at (y, x)."""
    difference, energy = np.float32(0), np.float32(0)
    for i in range(0, pixels.shape[0], step):
        r, c = y + pixels[i, 0], 2 * (x + pixels[i, 1])
        a, b = slopes[r, c], slopes[r, c + 1]
        da, db = a - there[i, 0], b - there[i, 1]
        difference += da * da + db * db
        energy += a * a + b * b
    return float(difference / (energy + ground))


@numba.njit(**PART)
def _ground(there: Float32, mean_energy: float, step: int) -> float:
    energy, count = 0.0, 0
    for i in range(0, there.shape[0], step):
        energy += there[i, 0] ** 2 + there[i, 1] ** 2
        count += 1
    return energy + _GROUND * mean_energy * count + 1e-12


@numba.njit(**INLINED)
def _find(
    pixels: Int32,
    there: Float32,
    slopes: Float32,
    starts: Int32,
    classes: Int32,
    penalty: Float64,
    mean_energy: float,
    candidates: int,
    seed: int,
    number: int,
) -> tuple[int, int]:
    """Return (row, column) of the patch of the exemplar that continues the pixels best."""
    rows, columns = classes.shape
    coarse = _ground(there, mean_energy, _COARSE)
    best = np.full(_REFINED, np.inf)
    kept = np.full(_REFINED, -1, np.int64)
    count = min(candidates, starts.size)
    for n in range(count):
        # All places if they are few.
        if count == starts.size:
            start = np.int64(starts[n])
        else:
            start = np.int64(starts[stream(seed, number, n) % np.uint64(starts.size)])
        y, x = divmod(start, columns)
        cost = _cost(pixels, there, slopes, y, x, coarse, _COARSE) * penalty[classes[y, x]]
        if cost < best[-1]:
            i = _REFINED - 1
            while i > 0 and best[i - 1] > cost:
                best[i], kept[i] = best[i - 1], kept[i - 1]
                i -= 1
            best[i], kept[i] = cost, start
    fine = _ground(there, mean_energy, 1)
    found_y, found_x, lowest = 0, 0, np.inf
    for i in range(_REFINED):
        if kept[i] < 0:
            break
        y, x = divmod(kept[i], columns)
        least = _cost(pixels, there, slopes, y, x, fine, 1) * penalty[classes[y, x]]
        for step in _STEPS:
            middle_y, middle_x = y, x
            for v in (middle_y - step, middle_y, middle_y + step):
                for u in (middle_x - step, middle_x, middle_x + step):
                    if not (0 <= v < rows and 0 <= u < columns) or classes[v, u] < 0:
                        continue
                    cost = _cost(pixels, there, slopes, v, u, fine, 1) * penalty[classes[v, u]]
                    if cost < least:
                        least, y, x = cost, v, u
        if least < lowest:
            lowest, found_y, found_x = least, y, x
    return found_y, found_x


@numba.njit(cache=True)
def quilt_holes(
    sheet: Float32,
    state: UInt8,
    sources: Int32,
    windows: Int32,
    band: int,
    side: int,
    vectors: Float32,
    slopes: Float32,
    starts: Int32,
    classes: Int32,
    shares: Float64,
    mean_energy: float,
    candidates: int,
    seed: int,
) -> None:
    """Place patches into the holes of a sheet, one after the other.

    Parameters
    ----------
    sheet, state, sources
        ``(H, W, 3)`` vectors, ``(H, W)`` states of the pixels, and ``(H, W)`` flat index of the
        pixel of the exemplar that each synthesised pixel was copied from; written.
    windows
        ``(n, 6)``: first row and column of each window, and the widths of its bands that
        windows before it share: left, top, right, bottom.
    band
        Distance from a hole within which known pixels are compared.
    side
        Side of a patch.
    vectors, slopes, starts, classes, shares, mean_energy
        The exemplar, as in `Exemplar`, without copies.
    candidates, seed
        Number of places that are compared, and the seed of their choice.
    """
    columns = vectors.shape[1]
    uses = np.zeros(shares.size)
    for number in range(windows.shape[0]):
        top, left = windows[number, 0], windows[number, 1]
        pixels = _compared(state, top, left, side, band)
        there = np.zeros((pixels.shape[0], 2), np.float32)
        for i in range(pixels.shape[0]):
            for k in range(2):
                there[i, k] = sheet[top + pixels[i, 0], left + pixels[i, 1], k]
        penalty = (uses + 1) / (number * shares + 1)
        y, x = _find(
            pixels, there, slopes, starts, classes, penalty, mean_energy, candidates, seed, number
        )
        uses[classes[y, x]] += 1
        old = np.ascontiguousarray(sheet[top : top + side, left : left + side])
        new = np.ascontiguousarray(vectors[y : y + side, x : x + side])
        bands = (windows[number, 2], windows[number, 3], windows[number, 4], windows[number, 5])
        taken = taken_pixels(old, new, bands)
        for r in range(side):
            for c in range(side):
                at = state[top + r, left + c]
                if at == HOLE or (at == MADE and taken[r, c]):
                    state[top + r, left + c] = MADE
                    sources[top + r, left + c] = (y + r) * columns + x + c
                    for k in range(3):
                        sheet[top + r, left + c, k] = new[r, c, k]
