"""Standard deviations of heights, by simulated errors of the normals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from processing.surface.anchors import Anchors
from processing.surface.chord_rule import ChordRule
from processing.surface.drift import Drift
from processing.surface.grid_graph import apply_laplacian, divergence
from processing.surface.multigrid import coarsened, solve
from rig import Progress, short_repr
from rig.arrays import Bool, Float32, Float64, Int32, Intp

# Simulated surfaces: a deviation of this many has an error of 1 / sqrt(2 * 24) = 14 %.
_SAMPLES = 24
_SEED = 20
# The errors themselves need not be known more accurately than this.
_TOLERANCE = 1e-3
_DISTANCES: Final = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)
# Pairs of pixels at each distance: fewer say little, more cost time.
_FEWEST_PAIRS = 100
_MOST_PAIRS = 50_000


@dataclass(frozen=True, eq=False)
class HeightUncertainty:
    """How sure the heights of a surface are.

    Parameters
    ----------
    sigma
        ``(H, W)`` float32 standard deviation of each height in the unit of the surface, relative to
        the mean height of its part, or to the prior of its part; NaN outside the mask.
    distances_px
        Distances in pixels along rows and columns, increasing.
    difference_sigma
        Standard deviation, in the unit of the surface, of the difference in height of two pixels of
        the same part at each of these distances: root mean square over the surface.
    """

    sigma: Float32
    distances_px: tuple[int, ...]
    difference_sigma: tuple[float, ...]

    __repr__ = short_repr

    def placed(self, window: tuple[slice, slice], size: tuple[int, int]) -> HeightUncertainty:
        """Return the same in an image of which this is a window."""
        sigma = np.full(size, np.nan, np.float32)
        sigma[window] = self.sigma
        return replace(self, sigma=sigma)


def simulate_errors(
    normals: Float32,
    mask: Bool,
    rule: ChordRule,
    steps: tuple[Float64, Float64],
    weights: tuple[Float32, Float32],
    labels: Int32,
    *,
    factor: Float32 | float,
    variances: Float32,
    common_deg: Float32,
    variance: float,
    held: Anchors | None,
    drift: Drift | None,
    guesses: tuple[Int32, Float64] | None,
    on_progress: Progress,
) -> HeightUncertainty:
    """Integrate perturbed normals with the weights of the surface.

    Each sample turns every normal by an independent angle of its deviation and all normals together
    by one, and integrates the change of the steps. Two edges that share a normal share its error.

    Parameters
    ----------
    normals, mask
        ``(H, W, 3)`` and ``(H, W)``, the normals.
    rule
        The chord rule.
    steps, weights
        ``(H+2, W+2)`` arrays of the surface.
    labels
        ``(H+2, W+2)`` its parts, -1 outside.
    factor
        Change of the height, in the unit of the surface, for a change of the solution of 1: a
        number, or ``(H, W)``.
    variances
        ``(H, W)`` variances of the normals in each tangent direction, in rad^2.
    common_deg
        ``(H, W)`` part of their deviations that all pixels share, such as errors of the lights; the
        rest is not shared, such as noise.
    variance
        Variance of a normal for the weights of known heights, in rad^2.
    held
        Known heights, which have errors of their own.
    drift
        How the surface drifts from them; None if it does not.
    guesses
        ``(H, W)`` pieces whose heights are guesses, -1 elsewhere, and the standard deviation of
        each, for a surface with jumps.
    on_progress
        Receives the stage ``errors of heights``, one step per sample.
    """
    inside = labels[1:-1, 1:-1] >= 0
    members = labels[1:-1, 1:-1][inside]
    shared = np.minimum(np.square(np.radians(common_deg)) / 2, variances)
    own, common = np.sqrt(variances - shared)[..., None], np.sqrt(shared)[..., None]
    count = int(members.max()) + 1
    scales = np.broadcast_to(factor, mask.shape)[inside].astype(np.float64)
    totals = np.bincount(members, scales)
    free = np.ones(count)
    held_weights = None
    if held is not None:
        held_weights, known = held.weights, held.weights > 0
        free[labels[held.weights > 0]] = 0
        # Of a prior, in the unit of the load of the right-hand side.
        loads = np.sqrt(held.weights * (variance / rule.step_px**2))
    squares = np.zeros(members.shape)
    pairs = _Pairs(labels[1:-1, 1:-1])
    error = np.full(mask.shape, np.nan)
    levels = coarsened(*weights, held_weights)
    own_levels = None if drift is None else coarsened(*weights, None)
    turns = _shared_turns()
    for sample in range(_SAMPLES):
        rng = np.random.default_rng([_SEED, sample])
        moved = normals + own * rng.standard_normal(normals.shape, np.float32)
        moved += common * turns[sample]
        moved /= np.linalg.norm(moved, axis=2, keepdims=True)
        right, down, moved_right, moved_down = rule.edges(moved.astype(np.float32), mask)
        # A perturbed normal may face away.
        change_right = np.where(right > 0, moved_right - steps[0], 0)
        change_down = np.where(down > 0, moved_down - steps[1], 0)
        b = divergence(*weights, change_right, change_down)
        if held is not None:
            errors = loads * rng.standard_normal(b.shape)
            if drift is not None:
                unheld = solve(*weights, b, levels=own_levels, tolerance=_TOLERANCE).u
                off = np.where(known, errors / np.where(known, held.weights, 1) - unheld, np.nan)
                bend = np.zeros_like(b)
                apply_laplacian(*weights, drift.of(off), bend)
                b += bend
            b += errors
        u = solve(*weights, b, anchors=held_weights, levels=levels, tolerance=_TOLERANCE).u
        if guesses is not None:
            # The last one is for the pixels without a guess.
            offsets = np.append(guesses[1] * rng.standard_normal(len(guesses[1])), 0.0)
            u[1:-1, 1:-1] += offsets[guesses[0]]
        found = scales * u[1:-1, 1:-1][inside]
        # The mean of each part without a prior is fixed.
        means = free * np.bincount(members, found) / totals
        found -= scales * means[members]
        squares += np.square(found)
        error[inside] = found
        pairs.add(error)
        on_progress("errors of heights", sample + 1, _SAMPLES)
    deviation = np.full(mask.shape, np.nan, np.float32)
    deviation[inside] = np.sqrt(squares / _SAMPLES)
    return HeightUncertainty(deviation, *pairs.deviations())


def _shared_turns() -> Float32:
    """Return a turn of all normals for each sample, ``(24, 3)``; the mean of their squares is 1.

    Few random numbers have other variances, by 15 %, and pixels do not average them.
    """
    drawn = np.random.default_rng(_SEED).standard_normal((_SAMPLES, 3))
    squares, axes = np.linalg.eigh(drawn.T @ drawn / _SAMPLES)
    return np.asarray(drawn @ (axes / np.sqrt(squares)) @ axes.T, np.float32)


class _Pairs:
    """Pairs of pixels of the same part in a row or column, at several distances."""

    def __init__(self, parts: Int32) -> None:
        self._pairs: list[tuple[int, Intp, Intp]] = []
        number = np.arange(parts.size).reshape(parts.shape)
        for distance in _DISTANCES:
            near, far = [], []
            for here, there in (
                (np.s_[:, :-distance], np.s_[:, distance:]),
                (np.s_[:-distance], np.s_[distance:]),
            ):
                same = (parts[here] == parts[there]) & (parts[here] >= 0)
                near.append(number[here][same])
                far.append(number[there][same])
            first, second = np.concatenate(near), np.concatenate(far)
            if len(first) < _FEWEST_PAIRS:
                break
            every = 1 + len(first) // _MOST_PAIRS
            self._pairs.append((distance, first[::every], second[::every]))
        self._squares = np.zeros(len(self._pairs))

    def add(self, error: Float64) -> None:
        """Add the errors of one sample."""
        flat = error.ravel()
        for i, (_, first, second) in enumerate(self._pairs):
            self._squares[i] += np.mean(np.square(flat[second] - flat[first]))

    def deviations(self) -> tuple[tuple[int, ...], tuple[float, ...]]:
        """Return the distances and the deviations of the differences, after all samples."""
        found = np.sqrt(self._squares / _SAMPLES)
        return tuple(pair[0] for pair in self._pairs), tuple(map(float, found))
