"""Corrections of blocks by their neighbours until all fit together."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from acquisition import BandFile
from processing._blocks.coarse import CoarseGrid
from processing._blocks.plan import Blocks
from processing._blocks.seams import Seam
from processing._surface.grid_graph import label_parts
from processing._surface.multigrid import solve
from rig import Progress

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]

# Residual of the changes of a block, relative to the range of heights.
_TOLERANCE = 2e-7
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
        For each seam, ``(2, W)`` changes of the first row of the lower block, and of the last row
        of the upper one.
    changes
        For each seam, ``(2h, W)`` float32 change of the difference.
    """

    demands: list[Double]
    changes: list[Float]


def bring_together(
    blocks: Blocks,
    seams: list[Seam],
    grid: CoarseGrid,
    weights: BandFile,
    solution: BandFile,
    several: list[bool],
    span: float,
    on_progress: Progress,
) -> Rounds:
    """Correct the blend of the solutions of all blocks until it is that of the whole.

    Parameters
    ----------
    blocks
        The blocks.
    seams
        What they share; the differences are changed.
    grid
        The coarse grid, with all weights.
    weights
        ``(H, 2, W)`` float32 weights of the edges to the right and down.
    solution
        ``(H, W)`` float64 blend; changed.
    several
        Whether each block has several parts.
    span
        Range of the solution.
    on_progress
        Receives the stage ``joining blocks``.
    """
    past: list[_Round] = []
    for count in range(_MOST_ROUNDS + 1):
        differences = [seam.difference for seam in seams]
        coarse = _correction(grid, seams, differences)
        error = float(np.abs(coarse[np.isfinite(coarse)]).max(initial=0)) + max(
            seam.largest for seam in seams
        )
        if error <= _ENOUGH * span or count == _MOST_ROUNDS:
            break
        demands = [np.zeros((2, seam.down.shape[1])) for seam in seams]
        if past:
            # All is linear: repeat earlier rounds as often as makes the differences smallest.
            factors = _factors(past, differences)
            for factor, earlier in zip(factors, past, strict=True):
                for place in range(len(seams)):
                    differences[place] = differences[place] + factor * earlier.changes[place]
                    demands[place] += factor * earlier.demands[place]
            coarse = _correction(grid, seams, differences)
        for seam, difference, (first, last) in zip(seams, differences, demands, strict=True):
            first += difference[0] + grid.row(coarse, seam.rows.start)
            last += grid.row(coarse, seam.rows.stop - 1) - difference[-1]
        # What remains of the residual of a change is not seen by later rounds.
        largest = max(float(np.abs(demand).max()) for demand in demands)
        tolerance = float(np.clip(_TOLERANCE * span / max(largest, 1e-30), 1e-9, 1e-2))
        changes = _change(
            blocks, seams, demands, weights, solution, several, tolerance, on_progress
        )
        past = [*past, _Round(demands, changes)][-_MEMORY:]
    return Rounds(count, error, error <= _ENOUGH * span)


def _correction(grid: CoarseGrid, seams: list[Seam], differences: list[Double]) -> Double:
    return grid.correction(
        [
            (seam.rows.start, seam.residual(difference))
            for seam, difference in zip(seams, differences, strict=True)
        ]
    )


def _factors(past: list[_Round], differences: list[Double]) -> Double:
    """Return the factors of earlier rounds that make the differences smallest."""
    products, load = np.zeros((len(past), len(past))), np.zeros(len(past))
    for i, one in enumerate(past):
        for seam, difference in enumerate(differences):
            load[i] -= np.vdot(one.changes[seam], difference)
            for j, other in enumerate(past):
                products[i, j] += np.vdot(one.changes[seam], other.changes[seam])
    return np.asarray(np.linalg.lstsq(products, load, rcond=1e-10)[0], np.float64)


def _change(
    blocks: Blocks,
    seams: list[Seam],
    demands: list[Double],
    weights: BandFile,
    solution: BandFile,
    several: list[bool],
    tolerance: float,
    on_progress: Progress,
) -> list[Float]:
    """Change all blocks as demanded; return by how much the differences changed."""
    changes = [np.zeros(seam.down.shape, np.float32) for seam in seams]
    on_progress("joining blocks", 0, len(blocks.blocks))
    for number, block in enumerate(blocks.blocks):
        above = demands[number - 1][0] if number else None
        below = demands[number][1] if number < len(seams) else None
        change = _harmonic(weights[block.rows], above, below, several[number], tolerance)
        if above is not None:
            shared = change[: 2 * blocks.halo]
            changes[number - 1] -= shared.astype(np.float32)
            seams[number - 1].difference -= shared
            shared *= 1 - seams[number - 1].share[:, None]
        if below is not None:
            shared = change[-2 * blocks.halo :]
            changes[number] += shared.astype(np.float32)
            seams[number].difference += shared
            shared *= seams[number].share[:, None]
        solution[block.rows] = solution[block.rows] + change
        on_progress("joining blocks", number + 1, len(blocks.blocks))
    return changes


def _harmonic(
    weights: Float, above: Double | None, below: Double | None, several: bool, tolerance: float
) -> Double:
    """Return the change of a block if its first and last row change by given amounts.

    Parameters
    ----------
    weights
        ``(h, 2, W)`` weights of the edges to the right and down.
    above, below
        ``(W,)`` changes; None if the block ends at the border of the image.
    several
        Whether the block has several parts.
    tolerance
        Residual relative to that of these changes.
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
    found = solve(right, down, b, anchors=anchors, tolerance=tolerance).u
    if several:
        # Nothing changes where no row that changes is connected: the solver leaves a constant.
        labels, count = label_parts(right, down)
        free = np.ones(count + 1, bool)
        free[labels[anchors > 0]] = free[-1] = False
        found[free[labels]] = 0
    change[first:last] = found[1:-1, 1:-1]
    return change
