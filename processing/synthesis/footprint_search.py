"""Compiled search for the place of an exemplar that continues a warped patch best."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from processing.synthesis.patch_search import GOLDEN, GROUND, REFINED, STEPS, mixed
from rig.arrays import Float32, Float64, Int32
from rig.kernels import INLINED, PART

# Compiled in: processing/synthesis/patch_search.py 1d7cb504f7ac
# Compiled in: rig/kernels/parts.py 986f6e8c38a7

_FAST = {"contract", "reassoc"}
# The random places are compared at every fifth known pixel.
_COARSE = 5
# A footprint that fits at a smaller share of the random places is made smaller by a factor.
_LEAST_FITTING = 0.02
_SMALLER = 0.85


class Places(NamedTuple):
    """The places of an exemplar, see `Exemplar`.

    Parameters
    ----------
    vectors
        ``(copies, h, w, 3)`` normals.
    slopes
        ``(copies * h * w, 2)`` n_x and n_y.
    classes, starts
        As in `Exemplar`.
    holes
        ``(copies, h + 1, w + 1)`` int32: number of pixels without a normal above and to the left.
    penalty
        Factor on the costs of each class.
    mean_energy
        Mean of n_x^2 + n_y^2.
    guide
        ``(copies * h * w,)`` scalar map that places are compared by; empty without guidance. A
        difference of 1 costs as much as two unrelated patches.
    """

    vectors: Float32
    slopes: Float32
    classes: Int32
    starts: Int32
    holes: Int32
    penalty: Float64
    mean_energy: float
    guide: Float32


class Wanted(NamedTuple):
    """What a patch should continue: its known pixels, and samples of its guide.

    Parameters
    ----------
    slopes
        ``(n, 2)`` n_x and n_y in the frame of the exemplar.
    offsets
        ``(n,)`` places in the exemplar relative to the centre of the patch, as flat indices.
    guide
        ``(m,)`` values of the guide in the complete patch; 0 values without guidance.
    guide_offsets
        ``(m,)`` their places, as `offsets`.
    """

    slopes: Float32
    offsets: Int32
    guide: Float32
    guide_offsets: Int32


@numba.njit(**PART)
def _fits(places: Places, copy: int, y: int, x: int, box: Int32) -> bool:
    """Return whether all pixels of a footprint have a normal."""
    top, bottom, left, right = y + box[0], y + box[1] + 1, x + box[2], x + box[3] + 1
    if top < 0 or left < 0:
        return False
    if bottom > places.classes.shape[1] or right > places.classes.shape[2]:
        return False
    holes = places.holes[copy]
    inside = holes[bottom, right] - holes[top, right] - holes[bottom, left] + holes[top, left]
    return bool(inside == 0)


@numba.njit(**INLINED, fastmath=_FAST, error_model="numpy")
def _cost(places: Places, wanted: Wanted, base: int, ground: float, step: int) -> float:
    difference, energy = np.float32(0), np.float32(0)
    for i in range(0, wanted.offsets.size, step):
        found = places.slopes[base + wanted.offsets[i]]
        a, b = wanted.slopes[i, 0] - found[0], wanted.slopes[i, 1] - found[1]
        difference += a * a + b * b
        energy += found[0] * found[0] + found[1] * found[1]
    apart = np.float32(0)
    for i in range(wanted.guide.size):
        d = wanted.guide[i] - places.guide[base + wanted.guide_offsets[i]]
        apart += d * d
    return float(difference / (energy + ground) + apart / max(wanted.guide.size, 1))


@numba.njit(**PART)
def _ground(wanted: Wanted, mean_energy: float, step: int) -> float:
    energy, pixels = 0.0, 0
    for i in range(0, wanted.offsets.size, step):
        energy += wanted.slopes[i, 0] ** 2 + wanted.slopes[i, 1] ** 2
        pixels += 1
    return energy + GROUND * mean_energy * pixels + 1e-12


@numba.njit(**PART)
def fitting(offsets: Float32, places: Places, patch: int, draws: int, state: np.uint64) -> float:
    """Return the factor that makes a footprint small enough to fit at several places.

    Parameters
    ----------
    offsets
        ``(n, n, 2)`` map of the patch.
    places
        The exemplar.
    patch
        Side of the patches of the exemplar.
    draws
        Number of random places.
    state
        State of the random numbers.
    """
    rows, columns = places.classes.shape[1], places.classes.shape[2]
    factor = 1.0
    while True:
        box = box_of(offsets, factor)
        least = -(patch // 2)
        if min(box[0], box[2]) >= least and max(box[1], box[3]) < least + patch:
            return factor
        count, random = 0, state
        for _ in range(draws):
            random += GOLDEN
            start = places.starts[mixed(random) % np.uint64(places.starts.size)]
            copy, place = divmod(start, rows * columns)
            y, x = divmod(place, columns)
            count += _fits(places, copy, y + patch // 2, x + patch // 2, box)
        if count >= _LEAST_FITTING * draws:
            return factor
        factor *= _SMALLER


@numba.njit(**PART)
def box_of(offsets: Float32, factor: float) -> Int32:
    """Return the first and last row and column of the nearest pixels of offsets, times a factor."""
    box = np.zeros(4, np.int32)
    for r in range(offsets.shape[0]):
        for c in range(offsets.shape[1]):
            for k in range(2):
                value = np.int32(math.floor(factor * offsets[r, c, k] + 0.5))
                box[2 * k] = min(box[2 * k], value)
                box[2 * k + 1] = max(box[2 * k + 1], value)
    return box


@numba.njit(**INLINED)
def find_footprint(
    wanted: Wanted, box: Int32, places: Places, patch: int, candidates: int, state: np.uint64
) -> tuple[int, int, int]:
    """Return (copy, row, column) of the centre of the footprint that continues a patch best.

    Parameters
    ----------
    wanted
        The known pixels of the patch.
    box
        Extent of the footprint, see `box_of`.
    places
        The exemplar.
    patch
        Side of the patches of the exemplar.
    candidates
        Number of random places, those at which the footprint does not fit included.
    state
        State of the random numbers.
    """
    rows, columns = places.classes.shape[1], places.classes.shape[2]
    half = patch // 2
    coarse = _ground(wanted, places.mean_energy, _COARSE)
    best = np.full(REFINED, np.inf)
    kept = np.full(REFINED, -1, np.int64)
    for _ in range(candidates):
        state += GOLDEN
        start = places.starts[mixed(state) % np.uint64(places.starts.size)]
        copy, place = divmod(start, rows * columns)
        y, x = divmod(place, columns)
        if not _fits(places, copy, y + half, x + half, box):
            continue
        centre = start + half * columns + half
        cost = _cost(places, wanted, centre, coarse, _COARSE)
        cost *= places.penalty[places.classes[copy, y, x]]
        if cost < best[-1]:
            i = REFINED - 1
            while i > 0 and best[i - 1] > cost:
                best[i], kept[i] = best[i - 1], kept[i - 1]
                i -= 1
            best[i], kept[i] = cost, start
    fine = _ground(wanted, places.mean_energy, 1)
    found, lowest = kept[0], np.inf
    for i in range(REFINED):
        if kept[i] < 0:
            break
        copy, place = divmod(kept[i], rows * columns)
        y, x = divmod(place, columns)
        least = np.inf
        for step in STEPS:
            middle_y, middle_x = y, x
            for dy in (-step, 0, step):
                for dx in (-step, 0, step):
                    v, u = middle_y + dy, middle_x + dx
                    if not (0 <= v < rows and 0 <= u < columns) or places.classes[copy, v, u] < 0:
                        continue
                    if not _fits(places, copy, v + half, u + half, box):
                        continue
                    centre = (copy * rows + v + half) * columns + u + half
                    cost = _cost(places, wanted, centre, fine, 1)
                    cost *= places.penalty[places.classes[copy, v, u]]
                    if cost < least:
                        least, y, x = cost, v, u
        if least < lowest:
            lowest, found = least, (copy * rows + y) * columns + x
    copy, place = divmod(found, rows * columns)
    y, x = divmod(place, columns)
    return copy, y + half, x + half
