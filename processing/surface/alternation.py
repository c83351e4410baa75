"""Weights of edges and surface, computed in turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from processing.surface import jump_kernels as kernels
from processing.surface.anchors import Anchors
from processing.surface.jump_evidence import JumpEvidence
from processing.surface.multigrid import solve
from rig.arrays import Float32, Float64

Pair = tuple[Float32, Float32]

_ROUNDS = 15
# Rounds in which the turn of the normals counts, if it does.
_UNEVEN_ROUNDS = 10
# Rounds from a surface whose pieces were moved, the first width of their gate in pixels, and by
# which factor it becomes narrower in each of them.
_LATE_ROUNDS, _LATE_WIDTH_PX, _LATE_NARROWER = 3, 1.0, 0.4
# The residual gate is as wide as this quantile of the residuals at first, becomes narrower by this
# factor in each round, and ends at this multiple of their deviation.
_LARGE = 0.99
_NARROWER = 0.7
_DEVIATIONS = 8.0
_LEAST_DEVIATION_PX = 0.02
_SAMPLES = 20_000
# Least factor of the weight of an edge across a certain jump, if the residuals are noise of
# `_LEAST_DEVIATION_PX` or more. It holds parts that only doubtful edges connect where the last
# surface had them; otherwise noise moves them further in every round. With less noise, it is less.
_LEAST_WEIGHT = 0.03
# In comparisons with a smooth surface, which spreads what it contradicts over many edges, an edge
# that is contradicted by so many deviations counts half.
_CONTRADICTING_DEVIATIONS = 3.0
# A known height that is missed by n deviations counts as this many contradicted edges times n^2: a
# jump without evidence is about as rare as a height that is 4 deviations wrong.
_EDGES_PER_SQUARE = 0.06
# Deviation of the residuals of a surface from normals with white noise, relative to the edges'.
_LEFT = 0.72
# The surface stands still when it moves by less, on average over all pixels, in pixels.
_STILL_PX = 0.01
# Of one round: later rounds change the weights anyway.
TOLERANCE = 0.01
_ITERATIONS = 12
# From the median of absolute values to a standard deviation.
_MEDIAN_TO_SIGMA = 1.4826


@dataclass(frozen=True, eq=False)
class Alternated:
    """A surface after the rounds from one start.

    Parameters
    ----------
    u
        ``(H+2, W+2)`` the surface.
    weights
        ``(H+2, W+2)`` the last weights of the edges to the right and down.
    rounds, iterations
        Number of rounds, and of iterations of the linear solver in all of them.
    relative_residual
        Of the linear solver in the last round.
    moved
        ``(H+2, W+2)`` by how much the last round moved the surface, in pixels.
    width
        Last width of the residual gate, in pixels.
    """

    u: Float64
    weights: Pair
    rounds: int
    iterations: int
    relative_residual: float
    moved: Float64
    width: float


@dataclass(frozen=True, eq=False)
class Alternation:
    """The rounds for one map of normals.

    Parameters
    ----------
    edges
        Weights and steps of the chord rule, see `processing.surface.chord_rule`.
    facing
        ``(H+2, W+2)`` float32 cosine between normal and line of sight.
    k
        Sharpness of the sigmoid, in 1/px^2.
    scale
        Pixels for a step of 1: 1, or the focal length in pixels for logarithms of depths.
    factors
        ``(H+2, W+2)`` float32 factors of the weights of edges, from the deviations of normals.
    held
        Known heights.
    continuity
        ``(H+2, W+2)`` probabilities that edges are continuous, which multiply their weights.
    """

    edges: tuple[Float32, Float32, Float32, Float32]
    facing: Float32
    k: float
    scale: float = 1.0
    factors: Pair | None = None
    held: Anchors | None = None
    continuity: Pair | None = None

    def shares(self, u: Float64) -> Pair:
        """Return how much each pixel trusts its right (lower) neighbour on a surface."""
        return kernels.shares(u, *self.edges[:2], self.facing, self.k, self.scale)

    def trust(self, u: Float64) -> Pair:
        """Return how much both pixels of each edge trust each other on a surface, 0 to 1."""
        right, down = self.edges[:2]
        shares = self.shares(u)
        trust = np.zeros_like(right), np.zeros_like(down)
        kernels.trust(right, shares[0], 0, trust[0])
        kernels.trust(down, shares[1], 1, trust[1])
        return trust

    def solved(self, even: Pair | None = None, *, after: Float64 | None = None) -> Alternated:
        """Compute surface and weights in turn.

        Parameters
        ----------
        even
            ``(H+2, W+2)`` additional factors of the weights in the first rounds.
        after
            ``(H+2, W+2)`` surface to improve in the last rounds only. It is changed.
        """
        right, down = edges = self.edges[:2]
        u = np.zeros(right.shape) if after is None else after
        weights = np.zeros_like(right), np.zeros_like(down)
        last = self.continuity or (np.ones_like(right),) * 2
        first = last if even is None else (last[0] * even[0], last[1] * even[1])
        pixels = max(int(np.count_nonzero(self.facing)), 1)
        iterations, begin, width, final, least = 0, np.inf, np.inf, 0.0, 0.0
        # From a surface, the rounds are the last ones.
        rounds, fresh = (_ROUNDS, 1) if after is None else (_LATE_ROUNDS, 0)
        narrower = _NARROWER if fresh else _LATE_NARROWER
        for number in range(fresh, rounds + fresh):
            late = number > _UNEVEN_ROUNDS or not fresh
            if number == 1 and fresh:
                shares = np.full_like(right, 0.5), np.full_like(down, 0.5)
                residuals = np.zeros_like(right), np.zeros_like(down)
            else:
                shares, residuals = self.shares(u), self._residuals(u)
                usual, largest = self._spread(residuals)
                if number == 2 * fresh:
                    begin = largest if fresh else _LATE_WIDTH_PX
                final = _DEVIATIONS * max(usual, _LEAST_DEVIATION_PX)
                width = max(final, begin * narrower ** (number - 2 * fresh))
                # In the first rounds, residuals are those of a surface that is still wrong.
                noise = min(usual / _LEAST_DEVIATION_PX, 1.0) if late else 0.0
                least = _LEAST_WEIGHT * noise**2
            for axis in (0, 1):
                kernels.gated_weights(
                    edges[axis],
                    self.facing,
                    shares[axis],
                    (last if late else first)[axis],
                    residuals[axis],
                    axis,
                    width,
                    least,
                    weights[axis],
                )
                if self.factors is not None:
                    weights[axis][...] *= self.factors[axis]
            # What the solver does not need does not add to its memory.
            del shares, residuals
            move = np.zeros(0)
            change = solve(
                *weights,
                self._imbalance(weights, u),
                anchors=None if self.held is None else self.held.weights,
                tolerance=TOLERANCE,
                max_iterations=_ITERATIONS,
            )
            move, iterations = change.u, iterations + change.iterations
            del change
            u += move
            moved = self.scale * float(np.abs(move).sum()) / pixels
            if moved < _STILL_PX and width <= final and late:
                break
        norm, left = (
            float(np.linalg.norm(self._imbalance(weights, surface)))
            for surface in (np.zeros_like(u), u)
        )
        relative = left / norm if norm else 0.0
        done = number + 1 - fresh
        return Alternated(u, weights, done, iterations, relative, self.scale * move, width)

    def contradiction(self, u: Float64, evidence: JumpEvidence) -> float:
        """Return about the weight of the edges that a surface contradicts by half a pixel."""
        each = zip(evidence.witness, evidence.order, self.edges[2:], strict=True)
        return sum(
            float(kernels.contradiction(u, *edges, axis, self.scale).sum())
            for axis, edges in enumerate(each)
        )

    def improves(
        self, u: Float64, smooth: Float64, evidence: JumpEvidence, known: Anchors | None
    ) -> bool:
        """Return whether a surface contradicts edges and known heights less than a smooth one.

        What noise explains does not count.
        """
        sums: list[float] = []
        width2 = 0.0
        for surface in (u, smooth):
            residuals = self._residuals(surface)
            if not sums:
                usual = max(self._spread(residuals)[0], _LEAST_DEVIATION_PX)
                usual = max(usual, _LEFT * evidence.noise_px)
                width2 = (_CONTRADICTING_DEVIATIONS * usual) ** 2
            squares = [residual * residual for residual in residuals]
            terms = zip(evidence.witness, squares, strict=True)
            sums.append(sum(float((w * r2 / (r2 + width2)).sum()) for w, r2 in terms))
            if known is not None:
                sums[-1] += _EDGES_PER_SQUARE * known.misfit(surface)
        return sums[0] < sums[1]

    def _imbalance(self, weights: Pair, u: Float64) -> Float64:
        """Return the right-hand side of the change that makes a surface fit the weighted edges."""
        b = kernels.imbalance(*weights, *self.edges[2:], u)
        if self.held is not None:
            b += self.held.weights * (self.held.target - u)
        return b

    def _residuals(self, u: Float64) -> Pair:
        right, down, to_right, to_down = self.edges
        out = np.zeros_like(right), np.zeros_like(down)
        kernels.residuals(u, right, to_right, 0, self.scale, out[0])
        kernels.residuals(u, down, to_down, 1, self.scale, out[1])
        return out

    def _spread(self, residuals: Pair) -> tuple[float, float]:
        """Return standard deviation, from the median, and a large quantile of the residuals."""
        sparse = max(1, int((self.edges[0].size / _SAMPLES) ** 0.5))
        some = [
            np.abs(residual[axis::sparse, ::sparse][edge[axis::sparse, ::sparse] > 0])
            for axis, (residual, edge) in enumerate(zip(residuals, self.edges[:2], strict=True))
        ]
        values = np.concatenate(some)
        if not values.size:
            return 0.0, np.inf
        median, large = np.quantile(values, [0.5, _LARGE])
        return _MEDIAN_TO_SIGMA * float(median), float(large)
