"""Compiled search for the place of an exemplar that continues a window of a sheet best.

A *window* is a square of the sheet that a patch will cover. Its *bands* are the widths of the
parts on its left, top, right and bottom that other patches cover already. Slopes are rows of
``(n_x, n_y)`` pairs, flat, so that every loop runs over contiguous memory.
"""

from __future__ import annotations

import numba
import numpy as np

from rig.arrays import Float32, Float64, Int32
from rig.kernels import INLINED, PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

Bands = tuple[int, int, int, int]

_FAST = {"contract", "reassoc"}
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
GOLDEN = np.uint64(0x9E3779B97F4A7C15)
# The share of the exemplar's energy in the denominator of the cost: with 0, a rough patch would
# continue a flat window as well as a flat one.
GROUND = 0.5
# Of the random places, this many are refined, by steps of these lengths.
REFINED = 4
_COARSE = 3
STEPS = (4, 2, 1, 1)


@numba.njit(**PART)
def mixed(value: np.uint64) -> np.uint64:
    """Return a number whose bits depend on all bits of the value."""
    once = (value ^ (value >> np.uint64(30))) * _MIX_1
    twice = (once ^ (once >> np.uint64(27))) * _MIX_2
    return twice ^ (twice >> np.uint64(31))


@numba.njit(**PART)
def stream(seed: int, row: int, column: int) -> np.uint64:
    """Return the first state of the random numbers of a patch."""
    state = mixed(np.uint64(seed) + GOLDEN)
    state = mixed(state ^ (np.uint64(row) + GOLDEN))
    first: np.uint64 = mixed(state ^ (np.uint64(column) + GOLDEN))
    return first


@numba.njit(**INLINED, fastmath=_FAST, error_model="numpy")
def _compare(a: Float32, b: Float32) -> tuple[np.float32, np.float32]:
    """Return the sums of (a - b)^2 and of b^2."""
    difference, energy = np.float32(0), np.float32(0)
    for i in range(a.size):
        d = a[i] - b[i]
        difference += d * d
        energy += b[i] * b[i]
    return difference, energy


@numba.njit(**INLINED, fastmath=_FAST, error_model="numpy")
def _cost(
    window: Float32,
    slopes: Float32,
    y: int,
    x: int,
    bands: Bands,
    ground: float,
    first: int,
    step: int,
) -> float:
    """Return the cost of continuing a window by the place (y, x), on every ``step``-th row."""
    height, width = window.shape[0], window.shape[1] // 2
    left, top, right, bottom = bands
    difference, energy = np.float32(0), np.float32(0)
    for r in range(first, height, step):
        row = slopes[y + r]
        if r < top or r >= height - bottom:
            d, e = _compare(window[r], row[2 * x : 2 * (x + width)])
            difference += d
            energy += e
            continue
        if left:
            d, e = _compare(window[r, : 2 * left], row[2 * x : 2 * (x + left)])
            difference += d
            energy += e
        if right:
            d, e = _compare(
                window[r, 2 * (width - right) :], row[2 * (x + width - right) : 2 * (x + width)]
            )
            difference += d
            energy += e
    return float(difference / (energy + ground))


@numba.njit(**PART)
def _ground(window: Float32, bands: Bands, mean_energy: float, first: int, step: int) -> float:
    """Return the part of the denominator of the cost that is common to all places."""
    height, width = window.shape[0], window.shape[1] // 2
    left, top, right, bottom = bands
    energy, pixels = 0.0, 0
    for r in range(first, height, step):
        whole = r < top or r >= height - bottom
        for c in range(width):
            if whole or c < left or c >= width - right:
                energy += window[r, 2 * c] ** 2 + window[r, 2 * c + 1] ** 2
                pixels += 1
    return energy + GROUND * mean_energy * pixels + 1e-12


@numba.njit(**INLINED)
def find_place(
    window: Float32,
    slopes: Float32,
    starts: Int32,
    classes: Int32,
    penalty: Float64,
    bands: Bands,
    mean_energy: float,
    candidates: int,
    state: np.uint64,
) -> tuple[int, int, int]:
    """Return (copy, row, column) of the place of the exemplar that continues a window best.

    Parameters
    ----------
    window
        ``(h, 2 w)`` slopes of the sheet.
    slopes
        ``(copies, H, 2 W)`` slopes of the exemplar and its turned copies.
    starts
        Flat indices into ``(copies, H, W)`` of the places at which a patch fits.
    classes
        ``(copies, H, W)``: class of the patch that starts at a place, -1 where none fits.
    penalty
        Factor on the costs of the patches of each class.
    bands
        Widths of the parts that are known: left, top, right, bottom.
    mean_energy
        Mean of n_x^2 + n_y^2 over the exemplar.
    candidates
        Number of random places.
    state
        State of the random numbers.
    """
    rows, columns = classes.shape[1], classes.shape[2]
    # The random places are compared on every third row.
    coarse = _ground(window, bands, mean_energy, 1, _COARSE)
    best = np.full(REFINED, np.inf)
    kept = np.full(REFINED, -1, np.int64)
    for _ in range(candidates):
        state += GOLDEN
        start = starts[mixed(state) % np.uint64(starts.size)]
        copy, place = divmod(start, rows * columns)
        y, x = divmod(place, columns)
        cost = _cost(window, slopes[copy], y, x, bands, coarse, 1, _COARSE)
        cost *= penalty[classes[copy, y, x]]
        if cost < best[-1]:
            i = REFINED - 1
            while i > 0 and best[i - 1] > cost:
                best[i], kept[i] = best[i - 1], kept[i - 1]
                i -= 1
            best[i], kept[i] = cost, start
    fine = _ground(window, bands, mean_energy, 0, 1)
    found, lowest = kept[0], np.inf
    for i in range(REFINED):
        if kept[i] < 0:
            break
        copy, place = divmod(kept[i], rows * columns)
        y, x = divmod(place, columns)
        least = _cost(window, slopes[copy], y, x, bands, fine, 0, 1)
        least *= penalty[classes[copy, y, x]]
        for step in STEPS:
            middle_y, middle_x = y, x
            for dy in (-step, 0, step):
                for dx in (-step, 0, step):
                    v, u = middle_y + dy, middle_x + dx
                    inside = 0 <= v < rows and 0 <= u < columns
                    if (dy == 0 and dx == 0) or not inside or classes[copy, v, u] < 0:
                        continue
                    cost = _cost(window, slopes[copy], v, u, bands, fine, 0, 1)
                    cost *= penalty[classes[copy, v, u]]
                    if cost < least:
                        least, y, x = cost, v, u
        if least < lowest:
            lowest, found = least, (copy * rows + y) * columns + x
    copy, place = divmod(found, rows * columns)
    y, x = divmod(place, columns)
    return copy, y, x
