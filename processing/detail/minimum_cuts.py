"""Compiled minimum-error cuts between a patch and what it overlaps."""

from __future__ import annotations

import math

import numba
import numpy as np

from rig.arrays import Bool, Float32, Int64
from rig.kernels import INLINED, PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

Bands = tuple[int, int, int, int]

_FAST = {"contract"}
# Weight of the step across a cut against the differences on both of its sides.
_ACROSS = np.float32(4)


@numba.njit(**INLINED, fastmath=_FAST)
def _cut(old: Float32, new: Float32, cut: Int64) -> None:
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


@numba.njit(**INLINED)
def _keep(old: Float32, new: Float32, taken: Bool) -> None:
    """Mark the pixels of a strip before its cut as not taken."""
    cut = np.zeros(len(old), np.int64)
    _cut(old, new, cut)
    for i in range(len(cut)):
        for j in range(cut[i]):
            taken[i, j] = False


@numba.njit(**PART)
def _turned(part: Float32) -> Float32:
    """Return a copy with rows and columns exchanged; to compile ``transpose`` takes longer."""
    out = np.zeros((part.shape[1], part.shape[0], 3), np.float32)
    for r in range(part.shape[0]):
        for c in range(part.shape[1]):
            for k in range(3):
                out[c, r, k] = part[r, c, k]
    return out


@numba.njit(**INLINED)
def taken_pixels(window: Float32, patch: Float32, bands: Bands) -> Bool:
    """Return which pixels of a window a patch replaces.

    Parameters
    ----------
    window, patch
        ``(h, w, 3)`` vectors that are there, and those of the patch.
    bands
        Widths of the parts of the window that are known: left, top, right, bottom; 0 for none. A
        band of 1 pixel is replaced completely.
    """
    left, top, right, bottom = bands
    taken = np.ones(window.shape[:2], np.bool_)
    if left > 1:
        _keep(window[:, :left], patch[:, :left], taken[:, :left])
    if right > 1:
        _keep(
            window[:, : -right - 1 : -1], patch[:, : -right - 1 : -1], taken[:, : -right - 1 : -1]
        )
    height, across = len(window), taken.T
    if top > 1:
        _keep(_turned(window[:top])[:, :top], _turned(patch[:top])[:, :top], across[:, :top])
    if bottom > 1:
        old, new = _turned(window[height - bottom :]), _turned(patch[height - bottom :])
        _keep(old[:, ::-1], new[:, ::-1], across[:, : -bottom - 1 : -1])
    return taken
