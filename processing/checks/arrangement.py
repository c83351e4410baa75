"""Whether images fit their lights much better in another order, or if the lights are turned."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from acquisition import Lights
from processing.checks import limits
from processing.checks.block_model import BlockModel, light_vectors, solved
from rig import pluralize
from rig.arrays import Float64, Intp

# Returns stored samples of light.
Stored = Callable[[Float64], Float64]

_BLOCKS = 600
_STEPS = 4
_LARGEST = 0.5
_FEWEST_LIGHTS = 6
_TURNS = {
    "upside down": (-1, -1, 1),
    "mirrored left to right": (-1, 1, 1),
    "mirrored top to bottom": (1, -1, 1),
}
_CODES: dict[str, str] = {
    "upside down": "images-turned",
    "mirrored left to right": "lights-mirrored",
    "mirrored top to bottom": "lights-mirrored",
}


class Arrangement(NamedTuple):
    """Another arrangement of the lights.

    Parameters
    ----------
    name
        Name of the cause.
    text
        What is wrong: "the images are upside down".
    residual
        What it leaves of the images.
    lights
        The lights in this arrangement.
    """

    name: str
    text: str
    residual: float
    lights: Lights

    @property
    def turned(self) -> bool:
        """Whether the images are turned, not their order."""
        return self.name != "lights-shuffled"

    @property
    def inverts(self) -> bool:
        """Whether it inverts the relief."""
        return self.name == "images-turned"


def residual_of(samples: Float64, vectors: Float64, stored: Stored | None = None) -> float:
    """Return the relative residual of blocks, with normals and albedo fitted robustly.

    Residuals are those of what ``stored`` returns of light: a curve that flattens samples would
    always seem to fit better.
    """
    measured = np.isfinite(samples)
    seen = np.where(measured, samples, 0.0)
    weights = measured.astype(np.float64)
    for _ in range(_STEPS):
        predicted = np.maximum((vectors @ solved(vectors, weights, seen)[..., None])[..., 0], 0)
        brightest = np.maximum(predicted.max(axis=1, keepdims=True), 1e-6)
        off = np.abs(seen - predicted) / brightest
        lit = measured & (predicted > 0.05 * brightest)
        spread = 1.4826 * float(np.median(off[lit])) if lit.any() else 1.0
        weights = np.where(lit, np.minimum(1, 2.5 * spread / np.maximum(off, 1e-9)), 1e-9)
    if stored is not None:
        predicted = stored(predicted)
        brightest = np.maximum(predicted.max(axis=1, keepdims=True), 1e-6)
        off = np.abs(stored(seen) - predicted) / brightest
    off = np.sort(np.minimum(off, _LARGEST)[measured] ** 2)
    kept = off[: max(1, int(0.95 * off.size))]
    return float(np.sqrt(kept.mean() / max(1 - 3 / samples.shape[1], 0.1)))


def better_arrangement(model: BlockModel, samples: Float64, lights: Lights) -> Arrangement | None:
    """Return the arrangement that leaves much less of the images than the given one, if any."""
    some = np.flatnonzero(model.valid)
    some = some[:: max(1, -(-len(some) // _BLOCKS))]
    count = len(lights)
    if count < _FEWEST_LIGHTS:
        return None
    # The surface was found under the given arrangement: others see a plane.
    points = model.points[some].copy()
    points[:, 2] = points[:, 2].mean()
    flat, samples = light_vectors(lights, points), samples[some]
    strengths = np.asarray(lights.intensities).mean(axis=1)
    given = min(residual_of(samples, vectors) for vectors in (model.vectors[some], flat))
    if given < limits.GOOD:
        return None
    found = []
    for text, signs in _TURNS.items():
        turned = _mirrored(lights, np.array(signs))
        residual = residual_of(samples, light_vectors(turned, points))
        found.append(Arrangement(_CODES[text], f"the images are {text}", residual, turned))
    for text, order in _orders(count):
        taken = lights.take([int(i) for i in order])
        # Samples were divided by the strengths of the given lights.
        residual = residual_of(samples * (strengths / strengths[order]), flat[:, order])
        lists = f"the lists of lights and images are {text}"
        found.append(Arrangement("lights-shuffled", lists, residual, taken))
    best = min(found, key=lambda one: one.residual)
    return best if best.residual < limits.BETTER * given else None


def turned_lights(lights: Lights, angle_deg: float) -> Lights:
    """Return the lights after a turn about the line of sight, counter-clockwise."""
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    matrix = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    if lights.positions_mm is None:
        return replace(lights, directions=lights.unit_directions @ matrix, axes=None)
    axes = np.asarray(lights.axes) @ matrix
    return replace(lights, positions_mm=lights.positions_mm @ matrix, axes=axes)


def _mirrored(lights: Lights, signs: Float64) -> Lights:
    if lights.positions_mm is None:
        return replace(lights, directions=lights.unit_directions * signs, axes=None)
    axes = np.asarray(lights.axes) * signs
    return replace(lights, positions_mm=lights.positions_mm * signs, axes=axes)


def _orders(count: int) -> Iterator[tuple[str, Intp]]:
    yield "in reverse order", np.arange(count)[::-1]
    both = "with one of the lists sorted as text (1, 10, 11, 2) and the other by number"
    for first in (0, 1):
        as_text = np.argsort([str(i + first) for i in range(count)])
        if (as_text != np.arange(count)).any():
            yield both, as_text
            yield both, np.argsort(as_text)
    for shift in range(1, count):
        places = pluralize(min(shift, count - shift), "place")
        yield f"shifted by {places}", np.roll(np.arange(count), shift)
