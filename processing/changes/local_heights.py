"""Heights of local changes, from differences of slopes inside regions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import cv2
import numpy as np
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from processing.changes.difference import Difference
from rig.arrays import Bool, Float32, Float64, Int32, Intp

# Integral of a cubic through four samples from the second to the third of them.
_STEP: Final = np.array([-1, 13, 13, -1]) / 24


class _Steps(NamedTuple):
    """Differences between neighbouring pixels of which one at least is in a region."""

    first: Intp
    second: Intp
    height: Float64
    along: int


def local_heights(difference: Difference, regions: Int32) -> Float32:
    """Return ``(H, W)`` change of height in pixels, 0 outside of the regions.

    The surface around a region counts as unchanged. Inside, heights are those whose differences
    between neighbours fit the slopes best.

    Parameters
    ----------
    difference
        Of the slopes.
    regions
        ``(H, W)`` number of the region from 1, 0 outside. A region ends one pixel before the
        border of the map.
    """
    if not regions.any():
        return np.zeros(regions.shape, np.float32)
    system = _System.of(difference, regions)
    return system.spread(system.solve(system.divergence()))


def height_variances(difference: Difference, regions: Int32, places: Intp) -> Float64:
    """Return the variance of the height at one pixel of each region, in square pixels.

    Parameters
    ----------
    places
        ``(N, 2)`` row and column in regions 1 to N.
    """
    system = _System.of(difference, regions)
    unit = np.zeros(system.count)
    unit[system.index[tuple(places.T)]] = 1
    weights = system.spread(system.solve(unit))
    variance = np.where(difference.known, 1 / np.maximum(difference.weight, 1e-12), 0)
    total = np.zeros(len(places) + 1)
    for axis in (0, 1):
        # The height is a sum over the slopes; its variance is that of their squares.
        gain = cv2.filter2D(
            _differences(weights, axis),
            cv2.CV_64F,
            _STEP[None] if axis else _STEP[:, None],
            anchor=(2, 0) if axis else (0, 2),
            borderType=cv2.BORDER_CONSTANT,
        )
        inside = np.nonzero(gain)
        label = _nearest(regions)[inside]
        total += np.bincount(label, gain[inside] ** 2 * variance[inside], minlength=len(total))[
            : len(total)
        ]
    return total[1:]


def _differences(values: Float32, axis: int) -> Float64:
    after = np.diff(values.astype(np.float64), axis=axis)
    return np.pad(after, ((0, 1), (0, 0)) if axis == 0 else ((0, 0), (0, 1)))


def _nearest(regions: Int32) -> Int32:
    """Return the regions, and the numbers of those within 3 pixels."""
    wide = cv2.dilate(regions.astype(np.float32), np.ones((7, 7), np.uint8))
    return np.where(regions > 0, regions, wide).astype(np.int32)


@dataclass(frozen=True, eq=False)
class _System:
    """Equations of the heights inside regions."""

    index: Intp
    count: int
    steps: list[_Steps]
    inside: Bool

    @classmethod
    def of(cls, difference: Difference, regions: Int32) -> _System:
        inside = regions > 0
        index = np.full(regions.shape, -1, np.intp)
        count = int(np.count_nonzero(inside))
        index[inside] = np.arange(count)
        steps = []
        for axis, slopes in ((1, difference.slopes[0]), (0, difference.slopes[1])):
            kernel = _STEP[None] if axis else _STEP[:, None]
            step = np.asarray(
                cv2.filter2D(
                    slopes.astype(np.float64),
                    -1,
                    kernel,
                    anchor=(1, 0) if axis else (0, 1),
                    borderType=cv2.BORDER_REPLICATE,
                ),
                np.float64,
            )
            here = np.s_[:, :-1] if axis else np.s_[:-1]
            there = np.s_[:, 1:] if axis else np.s_[1:]
            used = inside[here] | inside[there]
            steps.append(_Steps(index[here][used], index[there][used], step[here][used], axis))
        return cls(index, count, steps, inside)

    def divergence(self) -> Float64:
        right = np.zeros(self.count + 1)
        for step in self.steps:
            np.add.at(right, step.second, step.height)
            np.add.at(right, step.first, -step.height)
        return right[:-1]

    def solve(self, right: Float64) -> Float64:
        rows, columns, values = [], [], []
        for first, second, *_ in self.steps:
            both = (first >= 0) & (second >= 0)
            for at in (first, second):
                kept = at[at >= 0]
                rows.append(kept)
                columns.append(kept)
                values.append(np.ones(len(kept)))
            for a, b in ((first, second), (second, first)):
                rows.append(a[both])
                columns.append(b[both])
                values.append(-np.ones(int(both.sum())))
        entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
        matrix = csc_array(coo_array(entries, shape=(self.count, self.count)))
        return np.asarray(splu(matrix).solve(right))

    def spread(self, values: Float64) -> Float32:
        spread = np.zeros(self.inside.shape, np.float32)
        spread[self.inside] = values
        return spread
