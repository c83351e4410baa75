"""Planes that are fitted to a map around each pixel, with Gaussian weights."""

from __future__ import annotations

import math
from itertools import product
from typing import NamedTuple

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
    reach = window.reach
    # Sums of wide weights are smooth: single precision is enough.
    kind = np.float32 if wide else values.dtype
    complete = bool((np.asarray(weights) == 1).all())
    inside = np.pad(np.asarray(weights, kind), reach)
    weighted = np.pad(np.where(weights > 0, values, 0).astype(kind, copy=False), reach)
    weighted *= inside
    if wide:
        inside = _blurred_ones(inside, reach, scale_px) if complete else blurred(inside, scale_px)
        weighted = blurred(weighted, scale_px)
    shape = values.shape
    right, up = np.zeros((2, *(shape if slopes else (0, 0))), values.dtype)
    found = Planes(np.zeros(shape, values.dtype), right, up, np.zeros(shape, np.bool_))
    for row, column in product(range(0, shape[0], _BLOCK), range(0, shape[1], _BLOCK)):
        here = slice(row, row + _BLOCK), slice(column, column + _BLOCK)
        around = tuple(slice(part.start, part.stop + 2 * reach) for part in here)
        part = _solve(
            weighted[around].astype(np.float64),
            inside[around].astype(np.float64),
            weights[here] > 0,
            window,
            slopes=slopes,
        )
        for whole, block in zip(found, part, strict=True):
            if whole.size:
                whole[here] = block
    return found


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
    height, width = image.shape
    kernel = _Window.direct(_GRID_PX).powers[0]
    edge = len(kernel)
    edge += edge % 2
    fine = cv2.copyMakeBorder(image, edge, edge, edge, edge, cv2.BORDER_CONSTANT)
    coarse = np.ascontiguousarray(_convolved(np.asarray(fine, np.float32), kernel)[::2, ::2])
    left = math.sqrt(scale_px**2 - 2 * _GRID_PX**2) / 2
    spread = np.zeros(fine.shape, np.float32)
    spread[::2, ::2] = 4 * blurred(coarse, left)
    return _convolved(spread, kernel)[edge : edge + height, edge : edge + width]


def _blurred_ones(image: Floating, edge: int, scale_px: float) -> Float32:
    """Return what `blurred` makes of an image of ones with an edge of zeros."""
    down, across = (
        gaussian_filter1d(
            np.pad(np.ones(size - 2 * edge), edge), scale_px, mode="constant", truncate=_REACH
        ).astype(np.float32)
        for size in image.shape
    )
    return np.asarray(np.outer(down, across))


def _convolved(image: Float32, kernel: Float64) -> Float32:
    found = cv2.sepFilter2D(image, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(found, np.float32)
