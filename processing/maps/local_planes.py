"""Planes that are fitted to a map around each pixel, with Gaussian weights."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter1d

from rig.arrays import AnyArray, Bool, Float32, Float64, Floating

# The weights end at this many standard deviations; what is beyond is 4e-8 of the whole.
_REACH = 5.5
# Smallest variance of the positions along any direction, relative to that of a complete window;
# half of a window has 0.36.
_LEAST_SPREAD = 0.05
# Widest weights that are summed pixel by pixel. Wider ones are summed on coarser grids.
_WIDEST_PX = 6.0
# Standard deviation of the weights before and after a change of the grid, in pixels of the finer
# one: they let 3e-9 of its finest detail pass.
_GRID_PX = 2.0
# Steps of a derivative per standard deviation.
_STEPS = 8
# Pixels of a block that is computed at once, per side, and largest deviation of weights in it that
# count as complete.
_BLOCK, _COMPLETE = 512, 1e-5


class Planes(NamedTuple):
    """Planes ``value + right * x + up * y`` around each pixel, x and y in pixels.

    Parameters
    ----------
    value, right, up
        ``(H, W)``, of the type of the map; 0 where they are not known.
    known
        ``(H, W)`` bool, where the pixels with a weight determine them.
    """

    value: Floating
    right: Floating
    up: Floating
    known: Bool


class _Window(NamedTuple):
    """Weights of the pixels around one, by their distance, times powers 0, 1 and 2 of it."""

    powers: tuple[Float64, Float64, Float64]
    reach: int

    @classmethod
    def direct(cls, scale_px: float) -> _Window:
        reach = max(1, math.ceil(_REACH * scale_px))
        offset = np.arange(-reach, reach + 1, dtype=np.float64)
        weight = np.exp(-0.5 * (offset / scale_px) ** 2)
        weight /= weight.sum()
        return cls((weight, weight * offset, weight * offset**2), reach)

    @classmethod
    def of_blurred(cls, scale_px: float) -> _Window:
        """Return the same for a blurred image: products with the distance are derivatives."""
        step = max(1, round(scale_px / _STEPS))
        square = scale_px**2
        first, second, middle = np.zeros((3, 4 * step + 1))
        first[::step] = np.array([1, -8, 0, 8, -1]) / (12 * step)
        second[::step] = np.array([-1, 16, -30, 16, -1]) / (12 * step**2)
        middle[2 * step] = 1
        return cls((middle, square * first, square * middle + square**2 * second), 2 * step)

    def sums(self, image: Float64, across: Float64, down: Float64) -> Float64:
        """Return the weighted sums around the pixels of an image that have a complete window."""
        if np.count_nonzero(self.powers[0]) > 1:
            edge = slice(self.reach, -self.reach)
            filtered = cv2.sepFilter2D(image, cv2.CV_64F, across, down)
            return np.asarray(filtered, np.float64)[edge, edge]
        # Few of these weights are not 0.
        found: AnyArray = image
        for axis, weights in ((1, across), (0, down)):
            size = found.shape[axis] - 2 * self.reach
            lines = np.moveaxis(found, axis, 0)
            summed = sum(weights[at] * lines[at : at + size] for at in np.flatnonzero(weights))
            found = np.moveaxis(np.asarray(summed), 0, axis)
        return np.asarray(found, np.float64)


def fit_planes(
    values: Floating, weights: Floating | Bool, scale_px: float, *, slopes: bool = True
) -> Planes:
    """Fit planes by least squares with the weights ``exp(-(x^2 + y^2) / (2 scale^2))``.

    Parameters
    ----------
    values
        ``(H, W)``, finite where the weights are positive.
    weights
        ``(H, W)`` weight of each pixel, 0 or more, which multiplies that of its place; or a mask.
    scale_px
        Standard deviation of the weights in pixels.
    slopes
        Whether ``right`` and ``up`` are wanted; otherwise they have no pixels.
    """
    wide = scale_px > _WIDEST_PX
    window = _Window.of_blurred(scale_px) if wide else _Window.direct(scale_px)
    around = _Around(values, weights, np.dtype(np.float32) if wide else values.dtype)
    complete = bool((weights == 1).all())
    inside, weighted = around.weights, around.weighted
    if wide:
        # Sums of wide weights are smooth: single precision is enough.
        inside = (_BlurredOnes if complete else _Blurred)(inside, values.shape, scale_px).part
        weighted = _Blurred(weighted, values.shape, scale_px).part
    shape, reach = values.shape, window.reach
    right, up = np.zeros((2, *(shape if slopes else (0, 0))), values.dtype)
    found = Planes(np.zeros(shape, values.dtype), right, up, np.zeros(shape, np.bool_))
    for row, column in product(range(0, shape[0], _BLOCK), range(0, shape[1], _BLOCK)):
        rows, columns = (
            slice(first, min(first + _BLOCK, size))
            for first, size in zip((row, column), shape, strict=True)
        )
        wider = tuple(slice(part.start - reach, part.stop + reach) for part in (rows, columns))
        part = _solve(
            weighted(*wider).astype(np.float64),
            inside(*wider).astype(np.float64),
            weights[rows, columns] > 0,
            window,
            slopes=slopes,
        )
        for whole, block in zip(found, part, strict=True):
            if whole.size:
                whole[rows, columns] = block
    return found


# Returns rows and columns of a map, which may be beyond it.
_Part = Callable[[slice, slice], Floating]


class _Around(NamedTuple):
    """Parts of a map and its weights, 0 outside."""

    values: Floating
    mask: Floating | Bool
    kind: np.dtype[Any]

    def weights(self, rows: slice, columns: slice) -> Floating:
        return _cut(self.mask, rows, columns).astype(self.kind)

    def weighted(self, rows: slice, columns: slice) -> Floating:
        weights = self.weights(rows, columns)
        values = np.where(weights > 0, _cut(self.values, rows, columns), 0)
        return values.astype(self.kind, copy=False) * weights


def _cut(image: AnyArray, rows: slice, columns: slice) -> AnyArray:
    """Return rows and columns of an image, 0 outside."""
    parts = [
        (max(-part.start, 0), max(part.stop - size, 0))
        for part, size in zip((rows, columns), image.shape, strict=True)
    ]
    within = image[max(rows.start, 0) : rows.stop, max(columns.start, 0) : columns.stop]
    return np.pad(within, parts) if any(map(any, parts)) else within


class _Blurred:
    """An image that is blurred by a wide Gaussian, 0 outside, of which parts are computed.

    Parameters
    ----------
    image
        The image.
    shape
        Its height and width.
    scale_px
        Standard deviation of the blur.
    """

    def __init__(self, image: _Part, shape: tuple[int, ...], scale_px: float) -> None:
        kernel = _Window.direct(_GRID_PX).powers[0]
        reach = len(kernel) // 2
        # The windows of `_Window.of_blurred` reach beyond the border by a quarter of the scale.
        self._edge = edge = 2 * (len(kernel) + math.ceil(scale_px / 4))
        coarse = np.zeros([(size + 2 * edge + 1) // 2 for size in shape], np.float32)
        columns = slice(-edge - reach, 2 * coarse.shape[1] - edge + reach)
        for first in range(0, len(coarse), _BLOCK):
            last = min(first + _BLOCK, len(coarse))
            rows = slice(2 * first - edge - reach, 2 * last - edge + reach)
            fine = _convolved(np.asarray(image(rows, columns), np.float32), kernel)
            coarse[first:last] = fine[reach:-reach:2, reach:-reach:2]
        self._left = 4 * blurred(coarse, math.sqrt(scale_px**2 - 2 * _GRID_PX**2) / 2)
        self._kernel = kernel

    def part(self, rows: slice, columns: slice) -> Float32:
        """Return some rows and columns."""
        reach = len(self._kernel) // 2
        rows, columns = (
            slice(part.start + self._edge - reach, part.stop + self._edge + reach)
            for part in (rows, columns)
        )
        row, column = rows.start % 2, columns.start % 2
        spread = np.zeros((rows.stop - rows.start, columns.stop - columns.start), np.float32)
        spread[row::2, column::2] = _cut(
            self._left,
            slice((rows.start + row) // 2, (rows.stop + 1) // 2),
            slice((columns.start + column) // 2, (columns.stop + 1) // 2),
        )
        return _convolved(spread, self._kernel)[reach:-reach, reach:-reach]


class _BlurredOnes:
    """The same of an image of ones."""

    def __init__(self, _: _Part, shape: tuple[int, ...], scale_px: float) -> None:
        edge = self._edge = math.ceil(scale_px)
        self._sides = [
            gaussian_filter1d(
                np.pad(np.ones(size), edge), scale_px, mode="constant", truncate=_REACH
            ).astype(np.float32)
            for size in shape
        ]

    def part(self, rows: slice, columns: slice) -> Float32:
        """Return some rows and columns."""
        down, across = (
            side[part.start + self._edge : part.stop + self._edge]
            for side, part in zip(self._sides, (rows, columns), strict=True)
        )
        return np.asarray(np.outer(down, across))


def _solve(
    values: Float64, weights: Float64, inside: Bool, window: _Window, *, slopes: bool
) -> Planes:
    def moment(image: Float64, x: int, y: int) -> Float64:
        # Rows run down, y is up.
        return window.sums(image, window.powers[x], window.powers[y] * (-1) ** y)

    square = float(window.powers[2].sum())
    mean = moment(values, 0, 0)
    complete = np.abs(weights - 1).max() < _COMPLETE
    if complete and not slopes:
        return Planes(mean, mean, mean, inside)
    with_x, with_y = moment(values, 1, 0), moment(values, 0, 1)
    if complete:
        return Planes(mean, with_x / square, with_y / square, inside)
    total = np.where(inside, moment(weights, 0, 0), 1.0)
    x, y = moment(weights, 1, 0) / total, moment(weights, 0, 1) / total
    xx = moment(weights, 2, 0) / total - x * x
    xy = moment(weights, 1, 1) / total - x * y
    yy = moment(weights, 0, 2) / total - y * y
    least = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    known = inside & (least > _LEAST_SPREAD * square)
    determinant = np.where(known, xx * yy - xy * xy, 1.0)
    mean /= total
    with_x = with_x / total - x * mean
    with_y = with_y / total - y * mean
    right = np.where(known, (yy * with_x - xy * with_y) / determinant, 0.0)
    up = np.where(known, (xx * with_y - xy * with_x) / determinant, 0.0)
    return Planes(np.where(known, mean - right * x - up * y, 0.0), right, up, known)


def blurred(image: Float32, scale_px: float) -> Float32:
    """Return ``(H, W)`` an image blurred by a Gaussian, 0 outside; wide ones on coarser grids."""
    if scale_px <= _WIDEST_PX:
        window = _Window.direct(scale_px).powers[0]
        return _convolved(image, window)
    around = _Around(image, np.broadcast_to(np.True_, image.shape), np.dtype(np.float32))
    whole = slice(0, image.shape[0]), slice(0, image.shape[1])
    return _Blurred(around.weighted, image.shape, scale_px).part(*whole)


def _convolved(image: Float32, kernel: Float64) -> Float32:
    found = cv2.sepFilter2D(image, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(found, np.float32)
