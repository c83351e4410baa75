"""How well images fit their lights, and whether they fit them better in another order."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from acquisition import Lights
from processing.checks.self_calibration import solve
from processing.images.block_means import Cells, Samples, samples_of
from rig import pluralize
from rig.arrays import Bool, Float64, Intp

_FEWEST_IMAGES = 6
# Enough to compare orders, few enough to compare many.
_PIXELS = 600
# A good fit needs no other order.
_RESIDUAL = 0.05
# The other order must leave less than this factor.
_BETTER = 0.5
# Images that are exchanged in trials, the worst ones.
_WORST = 6


class Fit(NamedTuple):
    """Residuals of a matte surface under given lights, relative to the signal.

    Parameters
    ----------
    residual
        Median over the pixels of the rms deviation of their samples.
    per_image
        ``(N,)`` median absolute deviation of each image.
    """

    residual: float
    per_image: Float64


class Remedy(NamedTuple):
    """A change of the lights that makes them fit the images much better.

    Parameters
    ----------
    name
        What kind of mistake it is, for a message: ``in reverse order``; empty if images are named.
    images
        The two images of a swap, or the one that must be left out.
    residual
        The residual after the change.
    """

    name: str
    images: tuple[int, ...]
    residual: float


def fit(samples: Samples) -> Fit:
    """Fit a matte surface to samples by least squares."""
    count = samples.usable.shape[1]
    if not len(samples.values):
        return Fit(float("nan"), np.full(count, np.nan))
    normals = solve(samples.usable.astype(np.float64), samples.values, samples.vectors)
    deviation = np.where(samples.usable, samples.values - normals @ samples.vectors.T, 0.0)
    each = [
        float(np.median(np.abs(left[usable]))) if usable.any() else np.nan
        for left, usable in zip(deviation.T, samples.usable.T, strict=True)
    ]
    return Fit(relative_residual(deviation, samples.usable), np.array(each))


def relative_residual(deviation: Float64, usable: Bool) -> float:
    """Return the median over pixels of the rms deviation; samples have the rms 1."""
    rms = np.sqrt(np.sum(deviation**2, axis=1) / np.maximum(usable.sum(axis=1), 1))
    return float(np.median(rms))


def remedy(cells: Cells, lights: Lights, found: Fit) -> Remedy | None:
    """Try the usual mistakes: one wrong image, swaps, shifts, reverse order, names sorted as text.

    Returns None if the images fit the lights well, or no change makes them fit much better.
    """
    count = len(lights)
    if count < _FEWEST_IMAGES or not found.residual > _RESIDUAL:
        return None
    best = None
    least = _BETTER * fit(samples_of(cells, lights, _PIXELS)).residual
    for name, images, order in _trials(count, found.per_image):
        changed = cells
        if len(order) < count:
            changed = replace(cells, values=cells.values[order])
        residual = fit(samples_of(changed, lights.take([int(i) for i in order]), _PIXELS)).residual
        if residual < least:
            best, least = Remedy(name, images, residual), residual
    return best


def _trials(count: int, per_image: Float64) -> Iterator[tuple[str, tuple[int, ...], Intp]]:
    worst = np.argsort(-np.nan_to_num(per_image), kind="stable")[:_WORST]
    for i, j in combinations(sorted(int(k) for k in worst), 2):
        order = np.arange(count)
        order[[i, j]] = j, i
        yield "", (i, j), order
    if count > _FEWEST_IMAGES:
        for i in worst:
            yield "", (int(i),), np.delete(np.arange(count), i)
    yield "in reverse order", (), np.arange(count)[::-1]
    both = "if one of the lists is sorted as text (1, 10, 11, 2) and the other by number"
    for first in (0, 1):
        as_text = np.argsort([str(i + first) for i in range(count)])
        yield both, (), as_text
        yield both, (), np.argsort(as_text)
    for shift in range(1, count):
        name = f"if they are shifted by {pluralize(min(shift, count - shift), 'place')}"
        yield name, (), np.roll(np.arange(count), shift)
