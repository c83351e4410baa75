"""Compiled placement of patches: search, minimum-error cuts, hard copy into the sheet."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from processing._synthesis.patch_search import Bands, Double, Float, Whole, find_place, stream

# Compiled in: processing/_synthesis/patch_search.py f774940a9c88
Bytes = npt.NDArray[np.uint8]
Cut = npt.NDArray[np.int64]

_FAST = {"contract"}
# Weight of the step across a cut against the differences on both of its sides.
_ACROSS = np.float32(4)


@numba.njit(cache=True, fastmath=_FAST)
def _cut(old: Float, new: Float, cut: Cut) -> None:
    """Find the cut through a strip that is seen least, by dynamic programming.

    ``old`` and ``new`` are ``(n, w, 3)``. Pixels of row i before ``cut[i]`` stay old; the others
    become new. The cost of a cut is that of the differences on both of its sides and across it.
    """
    length, width = old.shape[0], old.shape[1]
    cost = np.zeros((length, width), np.float32)
    for i in range(length):
        for j in range(1, width):
            total = np.float32(0)
            for k in range(3):
                before = old[i, j - 1, k] - new[i, j - 1, k]
                after = old[i, j, k] - new[i, j, k]
                across = old[i, j - 1, k] - new[i, j, k]
                total += before * before + after * after + _ACROSS * across * across
            # The root makes the cost of a row an angle, so that one strong step does not decide
            # the course of the complete cut.
            cost[i, j] = math.sqrt(total)
        if i:
            for j in range(1, width):
                least = cost[i - 1, j]
                if j > 1:
                    least = min(least, cost[i - 1, j - 1])
                if j + 1 < width:
                    least = min(least, cost[i - 1, j + 1])
                cost[i, j] += least
    j = 1
    for t in range(2, width):
        if cost[length - 1, t] < cost[length - 1, j]:
            j = t
    for i in range(length - 1, -1, -1):
        if i < length - 1:
            for t in (j - 1, j + 1):
                if 1 <= t < width and cost[i, t] < cost[i, j]:
                    j = t
        cut[i] = j


@numba.njit(cache=True)
def pixels_taken(window: Float, patch: Float, bands: Bands) -> npt.NDArray[np.bool_]:
    """Return which pixels of a window a patch replaces."""
    height, width = window.shape[0], window.shape[1]
    left, top, right, bottom = bands
    taken = np.ones((height, width), np.bool_)
    down, across = np.zeros(height, np.int64), np.zeros(width, np.int64)
    if left > 1:
        _cut(window[:, :left], patch[:, :left], down)
        for r in range(height):
            taken[r, : down[r]] = False
    if right > 1:
        _cut(window[:, ::-1][:, :right], patch[:, ::-1][:, :right], down)
        for r in range(height):
            taken[r, width - down[r] :] = False
    old, new = window.transpose(1, 0, 2), patch.transpose(1, 0, 2)
    if top > 1:
        _cut(old[:, :top], new[:, :top], across)
        for c in range(width):
            taken[: across[c], c] = False
    if bottom > 1:
        _cut(old[:, ::-1][:, :bottom], new[:, ::-1][:, :bottom], across)
        for c in range(width):
            taken[height - across[c] :, c] = False
    return taken


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
    taken = pixels_taken(window, chosen, bands)
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


@numba.njit(parallel=True, cache=True)
def place_patches(
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
    """Place patches that touch no common pixel, in parallel.

    Parameters
    ----------
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
    for i in numba.prange(patches.shape[0]):
        known = (bands[i, 0], bands[i, 1], bands[i, 2], bands[i, 3])
        used[i] = _place(
            sheet, labels, patches[i], known, size, vectors, slopes, starts, classes, penalty,
            mean_energy, candidates, seed,
        )  # fmt: skip
