"""Sharpness of one frame relative to another of the same scene."""

from __future__ import annotations

import math
from itertools import product
from typing import Final

import cv2
import numpy as np

from rig.arrays import Bool, Float32, Float64

# Tiles whose ratios are averaged, and the longest side of one.
_MOST_TILES: Final = 64
_TILE_PX: Final = 128
_LEAST_TILE_PX: Final = 12
_LEAST_TILES: Final = 3
# Samples this close to the white level may be interpolated from saturated ones.
_BELOW_WHITE: Final = 0.98
# Correlation of the differences in both frames from which a tile shows structure, not only noise.
_COHERENT: Final = 0.3


def relative_sharpness(
    first: Float32,
    second: Float32,
    shift: Float64,
    white: float,
    excluded: Bool,
    cell_px: float,
) -> tuple[float, float]:
    """Return the contrast of the finest structure of one frame relative to another.

    It is the slope of the differences of neighbours in the second frame over those in the first,
    divided by the gain. Noise is in both; the slope is that of Deming's regression for noise
    whose variance grows with the light, which does not depend on its size.

    Parameters
    ----------
    first, second
        ``(H, W)`` light above black, not averaged.
    shift
        ``(right, down)`` of the content from the first to the second frame, pixels.
    white
        Light from which a sample is saturated.
    excluded
        Cells of ``cell_px`` pixels that do not fit.
    cell_px
        Side of a cell.

    Returns
    -------
    float, float
        Ratio, and its standard deviation from the scatter of tiles; NaN if too few tiles show
        structure.
    """
    height, width = first.shape
    side = int(np.clip(min(height, width) // 4, _LEAST_TILE_PX, _TILE_PX))
    ratios = []
    for y, x in _centres(height, width, side):
        if excluded[int(y / cell_px), int(x / cell_px)]:
            continue
        centres = np.array([[x, y] - shift / 2, [x, y] + shift / 2])
        if np.any(centres < side / 2) or np.any(centres > np.array([width, height]) - side / 2 - 1):
            continue
        # Each frame is interpolated half way, so that both are blurred alike.
        one, two = (
            np.asarray(
                cv2.getRectSubPix(image, (side, side), (float(right), float(down))), np.float32
            )
            for image, (right, down) in zip((first, second), centres, strict=True)
        )
        if max(one.max(), two.max()) < _BELOW_WHITE * white:
            ratios += _ratio(one, two)
    if len(ratios) < _LEAST_TILES:
        return math.nan, math.nan
    middle = float(np.median(ratios))
    scatter = 1.4826 * float(np.median(np.abs(np.array(ratios) - middle)))
    # The median of normal values varies by 1.2533 times as much as their mean.
    return middle, 1.2533 * scatter / len(ratios) ** 0.5


def _centres(height: int, width: int, side: int) -> list[tuple[float, float]]:
    """Return the centres (row, column) of tiles that are spread over the frame."""
    step = max(side, int((height * width / _MOST_TILES) ** 0.5))
    rows, columns = (
        np.arange(side / 2 + (length - side) % step / 2, length - side / 2 + 0.5, step) - 0.5
        for length in (height, width)
    )
    return list(product(rows.tolist(), columns.tolist()))


def _ratio(one: Float32, two: Float32) -> list[float]:
    """Return the ratio of the contrasts of two tiles; empty if they show no common structure."""
    levels = float(one.mean()), float(two.mean())
    if min(levels) <= 0:
        return []
    gain = levels[1] / levels[0]
    steps = [
        np.concatenate([np.diff(tile, axis=axis).ravel() for axis in (0, 1)]).astype(np.float64)
        for tile in (one, two)
    ]
    own, common, other = steps[0] @ steps[0], steps[0] @ steps[1], steps[1] @ steps[1]
    if common <= _COHERENT * (own * other) ** 0.5 or common <= 0:
        return []
    excess = (other - gain * own) / common
    slope = (excess + (excess * excess + 4 * gain) ** 0.5) / 2
    return [float(slope / gain)]
