"""Corrections of blocks by their neighbours until all fit together."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from processing.surface.blocks.block_solutions import OwnSolutions, Seam
from processing.surface.blocks.coarse import CoarseGrid
from processing.surface.grid_graph import label_parts
from processing.surface.multigrid import solve
from rig import Progress
from rig.arrays import Float32, Float64

# Largest error of the changes of a block, relative to the range of heights. Later rounds do not see
# it: it adds up.
_ACCURACY = 2e-6
# Residual, relative to that of the changes, at which their rounding errors are reached.
_ROUNDING = 1e-12
# Of the estimate: the largest share of an error that a round is taken to leave, and a factor.
_SLOWEST, _SAFETY = 0.9, 1.5
# Earlier rounds that are combined.
_MEMORY = 3
# The rounds end below this estimated error, relative to the range of heights.
_ENOUGH = 1e-4
_MOST_ROUNDS = 12


class Rounds(NamedTuple):
    """How blocks were brought together.

    Parameters
    ----------
    number
        Number of rounds.
    error
        Estimated largest error of the solution.
    settled
        Whether it is small enough.
    """

    number: int
    error: float
    settled: bool


class _Round(NamedTuple):
    """An earlier round.

    Parameters
    ----------
    demands
        ``(2, W)`` for each seam: changes of the first row of the lower block, and of the last row
        of the upper one.
    changes
        For each seam, ``(2h, W)`` float32 change of the difference.
    largest
        Largest change of a height.
    estimate
        Largest correction and difference before the round.
    """

    demands: Float64
    changes: list[Float32]
    largest: float
    estimate: float


def bring_together(
    own: OwnSolutions,
    grid: CoarseGrid,
    several: list[bool],
    span: float,
    on_progress: Progress,
) -> Rounds:
    """Correct the solutions of all blocks until their blend is that of the whole.

    Parameters
    ----------
    own
        The solutions; changed.
    grid
        The coarse grid, with all weights.
    several
        Whether each block has several parts.
    span
        Range of the solution.
    on_progress
        Receives the stage ``joining blocks``.
    """
    files, places = own.files, range(len(several) - 1)
    past: list[_Round] = []
    ratio = 1.0
    for count in range(_MOST_ROUNDS + 1):
        begun = files.record(f"round-{count}")
        if begun is None:
            seams = [own.seam(place) for place in places]
            differences = [seam.difference for seam in seams]
            coarse = _correction(grid, seams, differences)
            estimate = float(np.abs(coarse[np.isfinite(coarse)]).max(initial=0)) + max(
                (seam.largest for seam in seams), default=0.0
            )
            if past:
                remaining = min(estimate / past[-1].estimate, _SLOWEST)
                # The errors of all rounds are a geometric series.
                found = past[-1].largest / (1 - remaining)
                ratio = max(1.0, _SAFETY * found / past[-1].estimate)
            error = ratio * estimate + count * _ACCURACY * span
            if error <= _ENOUGH * span or count == _MOST_ROUNDS:
                return Rounds(count, error, error <= _ENOUGH * span)
            demands = _demands(grid, seams, past, coarse)
            begun = files.complete(f"round-{count}", demands=demands, estimate=estimate)
            del seams, differences, coarse
        demands = begun["demands"]
        changes, largest = _change(own, demands, several, count, _ACCURACY * span, on_progress)
        past = [*past, _Round(demands, changes, largest, float(begun["estimate"]))][-_MEMORY:]
    raise AssertionError("the last round returns")


def _demands(grid: CoarseGrid, seams: list[Seam], past: list[_Round], coarse: Float64) -> Float64:
    """Return for each seam ``(2, W)`` changes, as `_Round` has them."""
    differences = [seam.difference for seam in seams]
    demands = np.zeros((len(seams), 2, seams[0].down.shape[1]))
    if past:
        # All is linear: repeat earlier rounds as often as makes the differences smallest.
        for factor, earlier in zip(_factors(past, differences), past, strict=True):
            demands += factor * earlier.demands
            for place, changes in enumerate(earlier.changes):
                differences[place] = differences[place] + factor * changes
        coarse = _correction(grid, seams, differences)
    for seam, difference, (first, last) in zip(seams, differences, demands, strict=True):
        first += difference[0] + grid.row(coarse, seam.rows.start)
        last += grid.row(coarse, seam.rows.stop - 1) - difference[-1]
    return demands


def _correction(grid: CoarseGrid, seams: list[Seam], differences: list[Float64]) -> Float64:
    return grid.correction(
        [
            (seam.rows.start, seam.residual(difference))
            for seam, difference in zip(seams, differences, strict=True)
        ]
    )


def _factors(past: list[_Round], differences: list[Float64]) -> Float64:
    """Return the factors of earlier rounds that make the differences smallest."""
    products, load = np.zeros((len(past), len(past))), np.zeros(len(past))
    for i, one in enumerate(past):
        for seam, difference in enumerate(differences):
            load[i] -= np.vdot(one.changes[seam], difference)
            for j, other in enumerate(past):
                products[i, j] += np.vdot(one.changes[seam], other.changes[seam])
    return np.asarray(np.linalg.lstsq(products, load, rcond=1e-10)[0], np.float64)


def _change(
    own: OwnSolutions,
    demands: Float64,
    several: list[bool],
    count: int,
    accuracy: float,
    on_progress: Progress,
) -> tuple[list[Float32], float]:
    """Change all blocks as demanded; return by how much the differences and heights changed."""
    files, shared, total = own.files, 2 * own.blocks.halo, len(several)
    changes = [np.zeros((shared, demands.shape[2]), np.float32) for _ in demands]
    largest = 0.0
    on_progress("joining blocks", 0, total)
    for number, block in enumerate(own.blocks.blocks):
        name = f"change-{count}-{number}"
        done = files.record(name)
        if done is None:
            above = demands[number - 1][0] if number else None
            below = demands[number][1] if number < len(demands) else None
            change = _harmonic(files.weights[block.rows], above, below, several[number], accuracy)
            ends = change[:shared].astype(np.float32), change[-shared:].astype(np.float32)
            most = max(float(change.max()), -float(change.min()))
            change += own.solution(number).u
            files.write(f"solution-{number}-{count + 1}", change)
            del change
            done = files.complete(name, above=ends[0], below=ends[1], largest=most)
        own.advanced(number, count + 1)
        if number:
            changes[number - 1] -= done["above"]
        if number < len(demands):
            changes[number] += done["below"]
        largest = max(largest, float(done["largest"]))
        on_progress("joining blocks", number + 1, total)
    return changes, largest


def _harmonic(
    weights: Float32, above: Float64 | None, below: Float64 | None, several: bool, accuracy: float
) -> Float64:
    """Return the change of a block if its first and last row change by given amounts.

    Parameters
    ----------
    weights
        ``(h, 2, W)`` weights of the edges to the right and down.
    above, below
        ``(W,)`` changes; None if the block ends at the border of the image.
    several
        Whether the block has several parts.
    accuracy
        Largest error.
    """
    height, width = len(weights), weights.shape[2]
    first, last = 1 if above is not None else 0, height - (below is not None)
    right, down = np.zeros((2, last - first + 2, width + 2), np.float32)
    right[1:-1, 1:-1] = weights[first:last, 0]
    down[1:-1, 1:-1] = weights[first:last, 1]
    anchors, b = np.zeros_like(right), np.zeros(right.shape)
    change = np.zeros((height, width))
    if above is not None:
        change[0] = above
        anchors[1, 1:-1] += weights[0, 1]
        b[1, 1:-1] += weights[0, 1] * above
    if below is not None:
        change[-1] = below
        anchors[-2, 1:-1] += weights[-2, 1]
        b[-2, 1:-1] += weights[-2, 1] * below
    down[-2] = 0
    del weights
    found = solve(right, down, b, anchors=anchors, tolerance=_ROUNDING, accuracy=accuracy).u
    if several:
        # Nothing changes where no row that changes is connected: the solver leaves a constant.
        labels, count = label_parts(right, down)
        free = np.ones(count + 1, bool)
        free[labels[anchors > 0]] = free[-1] = False
        found[free[labels]] = 0
    change[first:last] = found[1:-1, 1:-1]
    return change
