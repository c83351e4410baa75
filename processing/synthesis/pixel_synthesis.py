"""Synthesis of a detail component pixel by pixel, as the reference of the paper."""

from __future__ import annotations

import math

import numba
import numpy as np

from acquisition import DataError
from processing.maps.normal_map import NormalMap, check_normal_map
from processing.synthesis.exemplar import prepare_exemplar
from processing.synthesis.patch_search import GOLDEN, mixed, stream
from processing.synthesis.quilting import check_seed
from processing.synthesis.sheet_synthesis import Synthesis
from rig import Progress, no_progress
from rig.arrays import Bool, Float32, Int32

# Compiled in: processing/synthesis/patch_search.py 1d7cb504f7ac

# Pixels of the sheet, times places of the exemplar, times pixels of a neighbourhood.
_MOST_COMPARISONS = 1e12
# Side of the square that is copied first, and the deviation of the weights relative to the side of
# a neighbourhood, as in the paper.
_FIRST = 3
_SIGMA = 1 / 6.4
# Places that are worse than the best by up to this share are candidates.
_TOLERANCE = np.float32(1.1)
_PIXELS_AT_ONCE = 256


def efros_leung(
    exemplar: NormalMap,
    size: tuple[int, int],
    *,
    patch: int = 11,
    seed: int = 0,
    on_progress: Progress = no_progress,
) -> Synthesis:
    """Continue a detail component over a small sheet pixel by pixel.

    The sheet grows around 3 x 3 pixels of the exemplar. Each pixel is copied from a place whose
    neighbourhood agrees with the known neighbours, drawn from all that are at most 10 % worse than
    the best (Efros and Leung, *Texture Synthesis by Non-parametric Sampling*, 1999). It is the
    reference with which `synthesize` is compared; it compares every pixel with every place.

    Parameters
    ----------
    exemplar
        Detail component, for instance of `separate`. Neighbourhoods lie inside its mask.
    size
        (height, width) of the sheet in pixels.
    patch
        Side of the neighbourhood in pixels, odd, 3 or more. Larger structures are lost.
    seed
        Fixes all random choices, 0 to 2^63 - 1.
    on_progress
        Receives the stages ``preparing`` and ``synthesising``, the latter with numbers of pixels.

    Returns
    -------
    Synthesis
        The sheet, float32; it has no patches, so the steps across cuts are NaN.

    Raises
    ------
    DataError
        If the exemplar is smaller than a neighbourhood, flat, or its mask has no room for one; if a
        number is out of range; if sheet, exemplar and neighbourhood together are too large.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap
    >>> from processing.synthesis import efros_leung
    >>> noise = np.random.default_rng(0).normal(scale=0.2, size=(24, 24, 3))
    >>> rough = NormalMap.from_vectors(noise + [0, 0, 1])
    >>> efros_leung(rough, (20, 30), patch=5).detail
    NormalMap(float32[20, 30, 3], 600 normals)
    """
    check_normal_map("exemplar", exemplar)
    height, width = size
    if min(size) < 1:
        raise DataError(f"a sheet of {width} x {height} pixels has no pixels")
    if patch < _FIRST or patch % 2 == 0:
        raise DataError(f"a neighbourhood of {patch} pixels is not odd, or less than {_FIRST}")
    check_seed(seed)
    on_progress("preparing", 0, 1)
    made = prepare_exemplar(exemplar, patch, rotate=False, mirror=False)
    half, columns = patch // 2, exemplar.size[1]
    places = (made.starts + half * columns + half).astype(np.int32)
    if float(height) * width * len(places) * patch * patch > _MOST_COMPARISONS:
        raise DataError(
            f"{width} x {height} pixels from {len(places)} places take too long pixel by pixel: "
            "use a smaller sheet, a smaller part of the exemplar, or quilting"
        )
    order = _order(height, width)
    sheet, known = np.zeros((height, width, 3), np.float32), np.zeros(size, np.bool_)
    offsets = np.arange(patch) - half
    weights = np.exp(-0.5 * (offsets / (_SIGMA * patch)) ** 2)
    around = np.outer(weights, weights).astype(np.float32)
    vectors = np.ascontiguousarray(exemplar.normals, np.float32).reshape(-1, 3)
    for first in range(0, len(order), _PIXELS_AT_ONCE):
        part = order[first : first + _PIXELS_AT_ONCE]
        _grow(sheet, known, part, first == 0, vectors, columns, places, around, seed)
        if not first:  # the first pixels wait for the compiler
            on_progress("preparing", 1, 1)
        on_progress("synthesising", first + len(part), len(order))
    detail = NormalMap.of_unit_vectors(sheet, known)
    return Synthesis(detail, np.zeros(size, np.uint8), patch, 0, False)


def _order(height: int, width: int) -> Int32:
    """Return (row, column) of all pixels in squares around the middle.

    Each square begins at the middles of its sides and ends at its corners, so that every pixel has
    a known neighbour.
    """
    y, x = np.indices((height, width), np.int32).reshape(2, -1)
    down, right = np.abs(y - height // 2), np.abs(x - width // 2)
    order = np.lexsort((x, y, np.minimum(down, right), np.maximum(down, right)))
    return np.stack([y, x], axis=1)[order]


@numba.njit(nogil=True, cache=True)
def _grow(
    sheet: Float32,
    known: Bool,
    order: Int32,
    begins: bool,
    vectors: Float32,
    columns: int,
    places: Int32,
    around: Float32,
    seed: int,
) -> None:
    """Copy a pixel of the exemplar into each pixel of an order.

    Parameters
    ----------
    sheet, known
        ``(H, W, 3)`` and ``(H, W)``, written.
    order
        ``(n, 2)`` rows and columns.
    begins
        Whether the order begins with the square that is copied from one place.
    vectors, columns, places
        ``(h * w, 3)`` exemplar, w, and flat indices of the centres of its neighbourhoods.
    around
        ``(p, p)`` weights of a neighbourhood.
    seed
        Seed of the random numbers.
    """
    rows, half = sheet.shape[0], around.shape[0] // 2
    middle_y, middle_x = rows // 2, sheet.shape[1] // 2
    start = places[mixed(stream(seed, -1, -1) + GOLDEN) % np.uint64(places.size)]
    values = np.zeros((around.size, 2), np.float32)
    weights, shifts = np.zeros(around.size, np.float32), np.zeros(around.size, np.int64)
    costs = np.zeros(places.size, np.float32)
    for i in range(len(order)):
        y, x = order[i, 0], order[i, 1]
        dy, dx = y - middle_y, x - middle_x
        if begins and max(abs(dy), abs(dx)) <= 1:
            chosen = start + dy * columns + dx
        else:
            count = 0
            for v in range(max(y - half, 0), min(y + half + 1, rows)):
                for u in range(max(x - half, 0), min(x + half + 1, sheet.shape[1])):
                    if known[v, u]:
                        values[count, 0], values[count, 1] = sheet[v, u, 0], sheet[v, u, 1]
                        weights[count] = around[v - y + half, u - x + half]
                        shifts[count] = (v - y) * columns + u - x
                        count += 1
            best = np.float32(math.inf)
            for k in range(places.size):
                total, most = np.float32(0), best * _TOLERANCE
                for j in range(count):
                    found = vectors[places[k] + shifts[j]]
                    a, b = values[j, 0] - found[0], values[j, 1] - found[1]
                    total += weights[j] * (a * a + b * b)
                    if total > most:
                        break
                costs[k] = total
                best = min(best, total)
            good = 0
            for k in range(places.size):
                good += costs[k] <= best * _TOLERANCE
            draw = int(mixed(stream(seed, y, x) + GOLDEN) % np.uint64(good))
            chosen = 0
            for k in range(places.size):
                if costs[k] <= best * _TOLERANCE:
                    if draw == 0:
                        chosen = places[k]
                        break
                    draw -= 1
        for k in range(3):
            sheet[y, x, k] = vectors[chosen, k]
        known[y, x] = True
