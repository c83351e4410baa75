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
import numpy.typing as npt

from processing._surface import jump_kernels as kernels
from processing._surface.grid_graph import apply_laplacian, divergence, label_parts
from processing._surface.multigrid import Solution, solve
from rig import Progress, no_progress, short_repr

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Labels = npt.NDArray[np.int32]
Mask = npt.NDArray[np.bool_]
Edges = tuple[Float, Float, Double, Double]

# Default sharpness of the sigmoid, in 1/px^2.
SHARPNESS: Final = 4.0
_ROUNDS = 15
# Rounds of the second start in which the turn of the normals counts.
_UNEVEN_ROUNDS = 10
# The residual gate is as wide as this quantile of the residuals at first, becomes narrower by this
# factor in each round, and ends at this multiple of their deviation.
_LARGE = 0.99
_NARROWER = 0.7
_DEVIATIONS = 8.0
_LEAST_DEVIATION_PX = 0.02
_SAMPLES = 100_000
# The surface stands still when it moves by less, on average over all pixels, in pixels.
_STILL_PX = 0.01
# If most of the surface still moves by this much in the last round, relative to its median, it is
# reported as not settled.
_SETTLED_PX = 0.1
# Of one round: later rounds change the weights anyway.
_TOLERANCE = 0.01
_ITERATIONS = 12
# A jump is a step of at least this size in pixels, between pixels that trust each other less than
# this. Of the depth jumps of more than 2 mm (5 px) in four captured objects, two thirds are found.
_JUMP_PX = 2.0
_JUMP_TRUST = 0.3
# Edges with less trust do not connect pieces: around a ball in front of a plane, some reach 0.45.
_PIECE_TRUST = 0.5
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

    right: Mask
    down: Mask
    doubt: Float
    pieces: npt.NDArray[np.int32]
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
    edges: Edges,
    facing: Float,
    even: tuple[Float, Float],
    *,
    k: float,
    scale: float = 1.0,
    on_progress: Progress = no_progress,
) -> tuple[Solution, Jumps]:
    """Compute the surface and the weights of its edges in turn, from two starts.

    Parameters
    ----------
    edges
        Weights and steps of the chord rule, see `processing._surface.chord_rule`.
    facing
        ``(H+2, W+2)`` float32 cosine between normal and line of sight.
    even
        ``(H+2, W+2)`` float32 weights of the edges by the turn of the normals, see
        `processing._surface.turns`.
    k
        Sharpness of the sigmoid, in 1/px^2.
    scale
        Pixels for a step of 1: 1, or the focal length in pixels for logarithms of depths.
    on_progress
        Receives the stage ``integrating``, in percent.

    Returns
    -------
    Solution
        The surface under the last weights; its iterations are those of all rounds.
    Jumps
        Where it jumps.
    """
    on_progress("integrating", 0, 100)
    indifferent = np.ones_like(even[0]), np.ones_like(even[1])
    first = _alternate(edges, facing, (indifferent, indifferent), k, scale)
    on_progress("integrating", 50, 100)
    second = _alternate(edges, facing, (even, indifferent), k, scale)
    width = min(first.width, second.width)
    found = min((first, second), key=lambda each: _misfit(each.u, edges, scale, width))
    on_progress("integrating", 100, 100)
    iterations = first.iterations + second.iterations
    # That the rounds end before the surface stands still is reported by the jumps.
    converged = found.relative_residual <= _TOLERANCE
    solution = Solution(found.u, iterations, found.relative_residual, converged=converged)
    right, down = edges[:2]
    shares = kernels.shares(found.u, right, down, facing, k, scale)
    weights = np.zeros_like(right), np.zeros_like(down)
    for axis in (0, 1):
        kernels.trust(edges[axis], shares[axis], axis, weights[axis])
    maps = _judged(scale * found.u, (right, down), weights)
    settled = found.last_change < _SETTLED_PX
    return solution, Jumps(*maps, found.rounds, found.last_change, settled=settled)


@dataclass(frozen=True, eq=False)
class _Alternation:
    """A surface after the rounds from one start."""

    u: Double
    rounds: int
    iterations: int
    relative_residual: float
    # Median change of the last round, in pixels, and the last width of the gate.
    last_change: float
    width: float


def _alternate(
    edges: Edges,
    facing: Float,
    even: tuple[tuple[Float, Float], tuple[Float, Float]],
    k: float,
    scale: float,
) -> _Alternation:
    """Compute surface and weights in turn; ``even`` are weights of the first and last rounds."""
    u = np.zeros(edges[0].shape)
    product = np.zeros_like(u)
    weights = np.zeros_like(edges[0]), np.zeros_like(edges[1])
    shares = np.full_like(edges[0], 0.5), np.full_like(edges[1], 0.5)
    residuals = np.zeros_like(edges[0]), np.zeros_like(edges[1])
    inside = facing != 0
    pixels = max(int(np.count_nonzero(inside)), 1)
    iterations, begin, width, final = 0, np.inf, np.inf, 0.0
    for rounds in range(1, _ROUNDS + 1):
        if rounds > 1:
            shares = kernels.shares(u, *edges[:2], facing, k, scale)
            _residuals(u, edges, scale, residuals)
            usual, largest = _spread(edges, residuals)
            begin = largest if rounds == 2 else begin
            final = _DEVIATIONS * max(usual, _LEAST_DEVIATION_PX)
            width = max(final, begin * _NARROWER ** (rounds - 2))
        for axis in (0, 1):
            kernels.gated_weights(
                edges[axis],
                facing,
                shares[axis],
                even[rounds > _UNEVEN_ROUNDS][axis],
                residuals[axis],
                axis,
                width,
                weights[axis],
            )
        b = divergence(*weights, *edges[2:])
        apply_laplacian(*weights, u, product)
        change = solve(*weights, b - product, tolerance=_TOLERANCE, max_iterations=_ITERATIONS)
        u += change.u
        iterations += change.iterations
        moved = scale * float(np.abs(change.u).sum()) / pixels
        if moved < _STILL_PX and width <= final and rounds > _UNEVEN_ROUNDS:
            break
    apply_laplacian(*weights, u, product)
    norm = float(np.linalg.norm(b))
    relative = float(np.linalg.norm(b - product)) / norm if norm else 0.0
    moves = change.u[inside]
    last = scale * float(np.median(np.abs(moves - np.median(moves)))) if moves.size else 0.0
    return _Alternation(u, rounds, iterations, relative, last, width)


def _residuals(u: Double, edges: Edges, scale: float, out: tuple[Float, Float]) -> None:
    for axis in (0, 1):
        kernels.residuals(u, edges[axis], edges[2 + axis], axis, scale, out[axis])


def _spread(edges: Edges, residuals: tuple[Float, Float]) -> tuple[float, float]:
    """Return standard deviation, from the median, and a large quantile of the residuals."""
    sparse = max(1, int((edges[0].size / _SAMPLES) ** 0.5))
    some = [
        np.abs(residual[axis::sparse, ::sparse][edges[axis][axis::sparse, ::sparse] > 0])
        for axis, residual in enumerate(residuals)
    ]
    values = np.concatenate(some)
    if not values.size:
        return 0.0, np.inf
    median, large = np.quantile(values, [0.5, _LARGE])
    return 1.4826 * float(median), float(large)


def _misfit(u: Double, edges: Edges, scale: float, width: float) -> float:
    residuals = np.zeros_like(edges[0]), np.zeros_like(edges[1])
    _residuals(u, edges, scale, residuals)
    return sum(float(kernels.misfit(residual, width).sum()) for residual in residuals)


def _judged(
    u: Double, edges: tuple[Float, Float], trust: tuple[Float, Float]
) -> tuple[Mask, Mask, Float, Labels]:
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


def _largest_first(labels: Labels, count: int, pixels: int) -> Labels:
    """Return the labels renumbered by the sizes of the pieces, -1 for crumbs."""
    sizes = np.bincount(labels[labels >= 0], minlength=count)
    order = np.argsort(-sizes, kind="stable")
    large = max(_SMALLEST_PIECE, _SMALLEST_SHARE * pixels)
    # The largest is a piece in any case.
    kept = order[: max(1, int(np.count_nonzero(sizes >= large)))]
    numbers = np.full(count + 1, -1, np.int32)
    numbers[kept] = np.arange(len(kept))
    return numbers[labels]
