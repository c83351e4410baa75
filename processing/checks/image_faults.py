"""Single images that the others do not predict, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from acquisition import angle_deg
from processing.checks import limits
from processing.checks.block_model import BlockModel, fit_blocks
from processing.checks.derivatives import LOBES, reflectance_of, slopes_of
from rig.arrays import Bool, Float64

_FEWEST_IMAGES = 6
_STEPS = 5
_FEWEST_ROWS = 3
_IDENTICAL = 1e-8
_TURNS = {
    "upside down": (-1, -1),
    "mirrored left to right": (1, -1),
    "mirrored top to bottom": (-1, 1),
}

Turned = Callable[[int, tuple[int, int]], Float64]


class ImageFault(NamedTuple):
    """What is wrong with one image.

    Parameters
    ----------
    image
        Its index.
    name
        Name of the cause.
    text
        What is wrong, after the name of the image.
    """

    image: int
    name: str
    text: str


class _Explained(NamedTuple):
    """An explanation of one image: its cost, how many parameters it has, and what it says."""

    cost: float
    parameters: int
    name: str
    text: str


def image_faults(model: BlockModel, turned: Turned, size: int, top: int) -> list[ImageFault]:
    """Find the images that the others do not predict, in their order.

    A wrong brightness or position of an image is left to the comparison of all images.

    Parameters
    ----------
    model
        P blocks of N images.
    turned
        Returns samples ``(P,)`` of an image whose rows and columns run by these signs.
    size, top
        Pixels along the side of a block, and the first row of the first block.
    """
    count = model.samples.shape[1]
    copies = _copies(model)
    if count < _FEWEST_IMAGES or len(copies) > max(2, count // 2):
        return []
    scale = _scale(model)
    costs = np.array([_cost(_off(model, i), scale) for i in range(count)])
    # The typical cost of images of shadows and gloss, not that of the worst ones.
    typical = float(np.median(costs))
    suspects = [int(i) for i in np.flatnonzero(costs > typical + limits.EXCESS)]
    if copies:
        suspects = sorted({*suspects, *copies})
    if not suspects or len(suspects) > limits.MOST_IMAGES * count:
        return []
    others = _without(model, suspects)
    scale = _scale(others)
    kept = [i for i in range(count) if i not in suspects]
    typical = float(np.median([_cost(_off(others, i), scale) for i in kept]))
    found = {}
    images = {i: _Image(others, i, scale, typical, size, top) for i in range(count)}
    for i in suspects:
        if images[i].cost < typical + limits.EXCESS:
            continue
        if i in copies:
            text = f"is the same image as that of {{{copies[i]}}}"
            found[i] = ImageFault(i, "image-duplicate", text)
        elif named := images[i].best(turned):
            found[i] = ImageFault(i, *named)
    for i, fault in list(found.items()):
        # Images of close lights that were exchanged deviate little.
        j = images[i].shows
        if fault.name == "images-swapped" and j not in found and images[j].prefers(i):
            found[j] = ImageFault(j, "images-swapped", f"shows the light of {{{i}}}")
    return [found[i] for i in sorted(found)]


def _copies(model: BlockModel) -> dict[int, int]:
    """Return images that are equal but for a factor, under different lights."""
    everywhere = (model.samples > 0).all(axis=1)
    if not everywhere.any():
        return {}
    unit = model.samples[everywhere] / np.linalg.norm(model.samples[everywhere], axis=0)
    middle = _unit(model.vectors.mean(axis=0))
    same = (1 - unit.T @ unit < _IDENTICAL) & (
        middle @ middle.T < np.cos(np.radians(limits.SAME_LIGHT_DEG))
    )
    return {int(i): int(j) for i, j in np.argwhere(same)[::-1]}


def _unit(vectors: Float64) -> Float64:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))


def _without(model: BlockModel, images: list[int]) -> BlockModel:
    samples = np.where(model.samples > 0, model.samples, np.nan)
    samples[:, images] = np.nan
    others = fit_blocks(samples, model.vectors, model.points, model.places, model.shape)
    return replace(others, samples=model.samples)


def _off(model: BlockModel, i: int) -> Float64:
    """Return residuals of an image relative to the albedo, NaN where it was not measured."""
    left = model.samples[:, i] - np.maximum(model.predicted[:, i], 0)
    counted = model.valid & (model.samples[:, i] > 0)
    return np.where(counted, left / _level(model), np.nan)


def _level(model: BlockModel) -> Float64:
    return np.asarray(np.maximum(model.predicted.max(axis=1), 1e-6))


def _scale(model: BlockModel) -> float:
    return limits.TOLERATED * max(model.relative_residual, limits.LEAST_RESIDUAL)


def _cost(off: Float64, scale: float) -> float:
    """Return the mean cost of residuals, 0..1."""
    known = off[np.isfinite(off)] / scale
    return float(np.mean(known**2 / (1 + known**2))) if len(known) else 0.0


class _Image:
    """One image, and what the others predict of it."""

    def __init__(
        self, model: BlockModel, i: int, scale: float, typical: float, size: int, top: int
    ) -> None:
        self._model, self._i, self._scale, self._typical = model, i, scale, typical
        self._size, self._top = size, top
        self._level = _level(model)
        self._seen = model.samples[:, i] / self._level
        self._predicted = np.maximum(model.predicted[:, i], 0) / self._level
        self._counted: Bool = np.asarray(model.valid & (model.samples[:, i] > 0))
        self.cost = self._cost(self._predicted)
        self.shows = i

    def best(self, turned: Turned) -> tuple[str, str] | None:
        """Return the name and the text of what explains it; None for brightness and position."""
        best = _Explained(self.cost, 0, "", "")
        tried = sorted(self._tried(turned), key=lambda one: (one.parameters, one.cost))
        for one in tried:
            few = one.parameters == best.parameters or best.cost > self._typical + limits.EXCESS
            if few and one.cost - self._typical < limits.LEFT * (best.cost - self._typical):
                best = one
        if best.parameters:
            return (best.name, best.text) if best.name else None
        if self.cost < limits.FOREIGN:
            return None
        off = np.median(np.abs(self._seen - self._predicted)[self._counted])
        return "image-disagrees", f"deviates by {off:.0%} of the signal under any light"

    def _tried(self, turned: Turned) -> Iterator[_Explained]:
        model = self._model
        yield _Explained(self._scaled(self._predicted), 1, "", "")
        right, down = (slope / self._level[:, None] for slope in slopes_of(model))
        vectors = model.vectors[:, self._i]
        slopes = [self._predicted, *((vectors * slope).sum(axis=1) for slope in (right, down))]
        yield _Explained(self._fitted(np.stack(slopes, axis=1)), 3, "", "")
        gloss = reflectance_of(model, np.arange(len(model.places)))
        lobes = [gloss[f"lobe {n}"][:, self._i] for n in LOBES]
        yield _Explained(self._fitted(np.stack([self._predicted, *lobes], axis=1)), 2, "", "")
        yield self._light()
        others = {j: self._under(j) for j in range(model.samples.shape[1]) if j != self._i}
        self.shows = min(others, key=lambda j: others[j])
        text = f"shows the light of {{{self.shows}}}"
        yield _Explained(others[self.shows], 2, "images-swapped", text)
        for name, signs in _TURNS.items():
            seen = turned(self._i, signs) / self._level
            yield _Explained(self._scaled(self._predicted, seen), 2, "image-turned", f"is {name}")
        yield self._clipped()
        yield from self._rows()

    def prefers(self, j: int) -> bool:
        """Return whether the image shows the light of another image rather than its own."""
        return self._under(j) < self._scaled(self._predicted)

    def _under(self, j: int) -> float:
        """Return the cost with the light of another image."""
        vectors, normals = self._model.vectors[:, j], self._model.scaled_normals
        return self._scaled(np.maximum((vectors * normals).sum(axis=1), 0) / self._level)

    def _cost(self, predicted: Float64, seen: Float64 | None = None) -> float:
        off = np.where(self._counted, (self._seen if seen is None else seen) - predicted, np.nan)
        return _cost(off, self._scale)

    def _scaled(self, predicted: Float64, seen: Float64 | None = None) -> float:
        """Return the cost of a prediction at any brightness."""
        return self._fitted(predicted[:, None], seen)

    def _fitted(self, columns: Float64, seen: Float64 | None = None) -> float:
        return self._cost(columns @ self._solved(columns, seen), seen)

    def _solved(self, columns: Float64, seen: Float64 | None = None) -> Float64:
        """Return robust coefficients of columns for the image."""
        target = self._seen if seen is None else seen
        usable = self._counted & np.isfinite(columns).all(axis=1) & np.isfinite(target)
        rows, target = columns[usable], target[usable]
        weights = np.ones(len(rows))
        found = np.zeros(columns.shape[1])
        for _ in range(_STEPS):
            weighted = rows * weights[:, None]
            products = weighted.T @ rows
            ridge = 1e-9 * np.trace(products) + 1e-12
            found = np.linalg.solve(products + ridge * np.eye(len(products)), weighted.T @ target)
            off = np.abs(target - rows @ found)
            typical = max(2 * float(np.median(off)) if len(off) else 0.0, self._scale)
            weights = 1 / (1 + (off / typical) ** 2) ** 2
        return found

    def _light(self) -> _Explained:
        """Return how well any change of its light vector explains the image."""
        model = self._model
        normals = model.scaled_normals / self._level[:, None]
        given = model.vectors[:, self._i]
        middle = given[self._counted].mean(axis=0)
        # Light vectors differ from that in the middle by what is known.
        aside = ((given - middle) * normals).sum(axis=1)
        lit = self._seen > 3 * self._scale
        columns = np.where(lit[:, None], normals, np.nan)
        light = self._solved(columns, self._seen - aside)
        cost = self._cost(np.maximum(aside + normals @ light, 0))
        angle = float(angle_deg(light, middle))
        if angle < limits.MOVED_DEG:
            return _Explained(cost, 3, "", "")
        text = f"has its light {angle:.1f} degrees from the given one"
        return _Explained(cost, 3, "light-moved", text)

    def _clipped(self) -> _Explained:
        largest = float(np.quantile((self._seen * self._level)[self._counted], 0.995))
        limit = largest / self._level
        lower = self._counted & (self._predicted < 0.5 * limit)
        gain = 1.0
        if lower.any():
            gain = float(np.median(self._seen[lower] / np.maximum(self._predicted[lower], 1e-3)))
        clipped = self._counted & (gain * self._predicted > limit)
        share = float(clipped.sum() / max(self._counted.sum(), 1))
        cost = self._cost(np.minimum(gain * self._predicted, limit))
        return _Explained(cost, 2, "image-clipped", f"is clipped in {share:.0%} of the object")

    def _rows(self) -> Iterator[_Explained]:
        """Yield rows that do not belong to the image, if they deviate over their whole width."""
        rows, across = np.divmod(self._model.places, self._model.shape[1])
        off = (self._seen - self._predicted) / self._scale
        each = np.where(self._counted, off**2 / (1 + off**2), 0.0)
        count = np.bincount(rows[self._counted], minlength=self._model.shape[0])
        sums = np.bincount(rows, weights=each, minlength=self._model.shape[0])
        first, last = _largest_sum(sums - limits.DEVIATING * count)
        inside = self._counted & (rows >= first) & (rows <= last)
        if last - first + 1 < _FEWEST_ROWS or inside.sum() > limits.MOST_ROWS * self._counted.sum():
            return
        beside = [row for row in (first - 2, last + 2) if 0 <= row < len(count) and count[row]]
        quiet = self._typical + limits.QUIET
        if not beside or any(sums[row] > quiet * count[row] for row in beside):
            return
        thirds = np.digitize(across[inside], np.quantile(across[inside], (1 / 3, 2 / 3)))
        shares = [np.mean(each[inside][thirds == k] > limits.DEVIATING) for k in range(3)]
        if min(shares) < limits.DEVIATING:
            return
        cost = (each[self._counted & ~inside].sum() + self._typical * inside.sum()) / max(
            int(self._counted.sum()), 1
        )
        pixels = self._top + first * self._size, self._top + (last + 1) * self._size - 1
        text = f"has rows {pixels[0]} to {pixels[1]} that do not belong to it"
        yield _Explained(float(cost), 2, "image-striped", text)


def _largest_sum(values: Float64) -> tuple[int, int]:
    """Return the first and the last place of the part with the largest sum."""
    after = np.concatenate([[0.0], np.cumsum(values)])
    least = np.minimum.accumulate(after)
    last = int(np.argmax(after[1:] - least[:-1]))
    return int(np.argmin(after[: last + 1])), last
