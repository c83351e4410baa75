"""Surfaces with jumps in depth: the weights of edges and the surface are computed in turn.

At an occlusion, the normals on both sides say nothing about the difference in depth. Each pixel
trusts the one of two opposite neighbours more that is nearer in depth, measured along its normal,
by a sigmoid (X. Cao, H. Santo, B. Shi, F. Okura and Y. Matsushita, "Bilateral normal integration",
ECCV 2022). There, each pixel has equations of its own; here an edge is an equation of two pixels,
by the chord rule, and both must trust it: its weight is that of the pixel that trusts it less.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from processing.surface.alternation import TOLERANCE, Alternated, Alternation
from processing.surface.grid_graph import label_parts
from processing.surface.jump_evidence import JumpEvidence, Pair
from processing.surface.multigrid import Solution
from processing.surface.placement import placed
from rig import Progress, no_progress, short_repr
from rig.arrays import Bool, Float32, Float64, Int32

# Default sharpness of the sigmoid, in 1/px^2.
SHARPNESS: Final = 4.0
# With a smaller share of suspect edges, no jumps are looked for: noise of 3 degrees has this share.
MOST_SUSPECTS: Final = 2e-5
# If this share of the surface does not stand still, up to this much in pixels and relative to its
# median, in the last round, it is reported as not settled.
_SETTLED_PX = 0.1
_SETTLED_QUANTILE = 0.9
# Edges with more trust hold a piece together while pieces are placed, one after the other.
_THRESHOLDS = (0.9, 0.8, 0.7, 0.5)
_SWEEPS = 3
# A placement is kept if it lessens the contradiction by this share.
_WORTHWHILE = 1e-3
# A jump is a step of at least this size in pixels, between pixels that trust each other less than
# this. Of the depth jumps of more than 2 mm (5 px) in four captured objects, two thirds are found.
_JUMP_PX = 2.0
_JUMP_TRUST = 0.3
# Edges with less trust do not connect pieces. At .6, 14 of 18 balls that hide their contact with
# the ground are pieces of their own, at .7 all of them.
_PIECE_TRUST = 0.7
# Smaller pieces, in pixels and relative to all pixels, are crumbs at the jumps.
_SMALLEST_PIECE = 50
_SMALLEST_SHARE = 1e-3


@dataclass(frozen=True, eq=False)
class Jumps:
    """Where a surface jumps in depth, and which of its pieces hang together.

    Parameters
    ----------
    right, down
        ``(H, W)`` bool, whether the surface jumps between a pixel and its right (lower) neighbour.
    doubt
        ``(H, W)`` float32, 0 to 1: how little a pixel and that of its neighbours which it trusts
        least trust each other; NaN outside the surface.
    pieces
        ``(H, W)`` int32 number of the piece of each pixel, the largest piece first; -1 outside and
        at crumbs between pieces. The heights of pieces relative to each other are guesses.
    rounds
        How often the weights and the surface were computed.
    last_change
        By how much the last round moved the surface in itself, in pixels: the median over all
        pixels.
    settled
        Whether the surface stood still at the end: the last round moved it by less than .1 px.
    """

    right: Bool
    down: Bool
    doubt: Float32
    pieces: Int32
    rounds: int
    last_change: float
    settled: bool

    __repr__ = short_repr

    def placed(self, window: tuple[slice, slice], size: tuple[int, int]) -> Jumps:
        """Return the same jumps in an image of which this is a window."""
        right, down = np.zeros(size, bool), np.zeros(size, bool)
        doubt = np.full(size, np.nan, np.float32)
        pieces = np.full(size, -1, np.int32)
        right[window], down[window] = self.right, self.down
        doubt[window], pieces[window] = self.doubt, self.pieces
        return replace(self, right=right, down=down, doubt=doubt, pieces=pieces)

    @property
    def count(self) -> int:
        """Number of pairs of neighbours between which the surface jumps."""
        return int(np.count_nonzero(self.right)) + int(np.count_nonzero(self.down))


def solve_with_jumps(
    problem: Alternation,
    evidence: JumpEvidence,
    even: Pair,
    on_progress: Progress = no_progress,
) -> tuple[Solution, Jumps, Pair]:
    """Compute the surface and the weights of its edges in turn, and place its pieces.

    Where the normals of both sides differ little, only abrupt turns of smoothed normals show a rim;
    elsewhere they are misleading. Of two starts, with and without them, that continues which fewer
    edges contradict. Its pieces are then moved to where the edges between them agree; what lessens
    the contradiction is kept.

    Parameters
    ----------
    problem
        The normals, as steps between pixels.
    evidence
        What the normals say about jumps.
    even
        ``(H+2, W+2)`` float32 weights of the edges by the turn of smoothed normals, see
        `processing.surface.normal_turns`.
    on_progress
        Receives the stage ``integrating``, in percent.

    Returns
    -------
    Solution
        The surface under the last weights; its iterations are those of all rounds.
    Jumps
        Where it jumps.
    weights
        ``(H+2, W+2)`` the last weights of the edges to the right and down.
    """
    right, down, *steps = problem.edges

    def contradiction(found: Alternated) -> float:
        return problem.contradiction(found.u, evidence.witness)

    on_progress("integrating", 0, 100)
    first = problem.solved()
    on_progress("integrating", 30, 100)
    second = problem.solved(even)
    on_progress("integrating", 60, 100)
    found = min((first, second), key=contradiction)
    least, iterations = contradiction(found), first.iterations + second.iterations
    for sweep in range(_SWEEPS):
        before = found
        for threshold in _THRESHOLDS:
            trust = problem.trust(found.u)
            u = placed(
                found.u, (steps[0], steps[1]), evidence.witness, trust, threshold, problem.scale
            )
            moved = problem.solved(after=u)
            iterations += moved.iterations
            if contradiction(moved) < (1 - _WORTHWHILE) * least:
                found, least = moved, contradiction(moved)
        on_progress("integrating", 60 + 40 * (sweep + 1) // _SWEEPS, 100)
        if found is before:
            break
    on_progress("integrating", 100, 100)
    # That the rounds end before the surface stands still is reported by the jumps.
    converged = found.relative_residual <= TOLERANCE
    solution = Solution(found.u, iterations, found.relative_residual, converged=converged)
    maps = _judged(problem.scale * found.u, (right, down), problem.trust(found.u))
    moves = found.moved[problem.facing != 0]
    within = np.abs(moves - np.median(moves)) if moves.size else np.zeros(1)
    last_change = float(np.quantile(within, _SETTLED_QUANTILE))
    jumps = Jumps(*maps, found.rounds, last_change, settled=last_change < _SETTLED_PX)
    return solution, jumps, found.weights


def _judged(
    u: Float64, edges: tuple[Float32, Float32], trust: tuple[Float32, Float32]
) -> tuple[Bool, Bool, Float32, Int32]:
    """Find jumps, doubt and pieces of a surface in pixels from the trust between neighbours."""
    inner = slice(1, -1), slice(1, -1)
    linked = (edges[0] > 0) | (edges[1] > 0)
    linked[:, 1:] |= edges[0][:, :-1] > 0
    linked[1:] |= edges[1][:-1] > 0
    doubt = np.zeros(u.shape, np.float32)
    jumps = []
    for axis, (edge, confidence) in enumerate(zip(edges, trust, strict=True)):
        here, there = (np.s_[:, :-1], np.s_[:, 1:]) if axis == 0 else (np.s_[:-1], np.s_[1:])
        # Of pixels without an edge between them, the normals are opposed, or grazing.
        steep = np.abs(u[there] - u[here]) > _JUMP_PX
        jump = np.zeros(u.shape, bool)
        jump[here] = steep & linked[here] & linked[there] & (confidence[here] < _JUMP_TRUST)
        jumps.append(jump[inner])
        little = np.where(edge[here] > 0, 1 - confidence[here], 0)
        np.maximum(doubt[here], little, out=doubt[here])
        np.maximum(doubt[there], little, out=doubt[there])
    doubt[~linked] = np.nan
    held = [np.where(confidence > _PIECE_TRUST, confidence, 0) for confidence in trust]
    labels, count = label_parts(*held)
    pieces = _largest_first(labels[inner], count, int(np.count_nonzero(linked)))
    return jumps[0], jumps[1], doubt[inner].copy(), pieces


def _largest_first(labels: Int32, count: int, pixels: int) -> Int32:
    """Return the labels renumbered by the sizes of the pieces, -1 for crumbs."""
    # A line of pixels at a rim is a crumb: the pixels that count have neighbours in a square.
    corner = labels[:-1, :-1]
    square = (corner >= 0) & (corner == labels[1:, 1:])
    square &= (corner == labels[:-1, 1:]) & (corner == labels[1:, :-1])
    sizes = np.bincount(corner[square], minlength=count)
    order = np.argsort(-sizes, kind="stable")
    large = max(_SMALLEST_PIECE, _SMALLEST_SHARE * pixels)
    # The largest is a piece in any case.
    kept = order[: max(1, int(np.count_nonzero(sizes >= large)))]
    numbers = np.full(count + 1, -1, np.int32)
    numbers[kept] = np.arange(len(kept))
    return numbers[labels]
