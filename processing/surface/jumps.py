"""Surfaces with jumps in depth: the weights of edges and the surface are computed in turn.

At an occlusion, the normals on both sides say nothing about the difference in depth. Each pixel
trusts the one of two opposite neighbours more that is nearer in depth, measured along its normal,
by a sigmoid (X. Cao, H. Santo, B. Shi, F. Okura and Y. Matsushita, "Bilateral normal integration",
ECCV 2022). There, each pixel has equations of its own; here an edge is an equation of two pixels,
by the chord rule, and both must trust it: its weight is that of the pixel that trusts it less.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from processing.surface.alternation import TOLERANCE, Alternated, Alternation
from processing.surface.anchors import Anchors
from processing.surface.chord_rule import ChordRule
from processing.surface.grid_graph import label_parts
from processing.surface.jump_evidence import JumpEvidence, Pair, jump_evidence
from processing.surface.jump_resampling import median_surface, random_weights
from processing.surface.multigrid import Solution
from processing.surface.normal_turns import evenness
from processing.surface.placement import linked, placed
from processing.surface.rim_basins import Basins
from rig import Progress, no_progress, short_repr
from rig.arrays import AnyArray, Bool, Float32, Float64, Int32

# Default sharpness of the sigmoid, in 1/px^2.
SHARPNESS: Final = 4.0
# With a smaller share of suspect edges, no jumps are looked for: noise of 3 degrees has this share.
LEAST_SUSPECTS: Final = 2e-5
# If this share of the surface does not stand still, up to this much in pixels and relative to its
# median, in the last round, it is reported as not settled.
_SETTLED_PX = 0.1
_SETTLED_QUANTILE = 0.9
# Pieces are placed by votes that agree within these widths in pixels, one after the other.
_WIDTHS_PX = (4.0, 2.0, 1.0, 0.5)
# Searches with resampled evidence; and the contradiction of a surface that is clearly better than
# their median, relative to that of the median.
_SEARCHES, _CLEARLY = 7, 0.95
# The first surfaces are enough if they differ by more than this, in pixels, on a smaller share.
_FEWEST, _APART_PX, _APART_SHARE = 3, 0.5, 0.01
# In a map with more pixels, pieces are searched in one of half the size.
_LARGEST_SEARCH = 150_000
# Normals of a square of pixels whose sum is shorter have no mean.
_LEAST_SUM = 0.5
# A jump is a step of at least this size in pixels, between pixels that trust each other less than
# this. Of the depth jumps of more than 2 mm (5 px) in four captured objects, two thirds are found.
_JUMP_PX = 2.0
_JUMP_TRUST = 0.3
# Beyond rims of edges that are less probably continuous, a piece without known heights is a guess.
_CONTINUOUS = 0.8
# Edges with less trust do not connect pieces. At 0.6, 14 of 18 balls that hide their contact with
# the ground are pieces of their own, at 0.7 all of them.
_PIECE_TRUST = 0.7
# Smaller pieces, in pixels and relative to all pixels, are crumbs at the jumps.
_SMALLEST_PIECE = 50
_SMALLEST_SHARE = 1e-3
# Weight, relative to edges, of the heights of all pixels of a surface that is held at another one:
# it holds the surface over 100 pixels and more.
_HELD = np.float32(1e-4)


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
        Whether the surface stood still at the end: the last round moved it by less than 0.1 px.
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


class CoarseSurface(NamedTuple):
    """A surface in large pixels.

    Parameters
    ----------
    u
        ``(h, w)`` surface.
    cell
        Pixels of the image along the side of a pixel.
    """

    u: Float64
    cell: int


@dataclass(frozen=True, eq=False)
class JumpProblem:
    """The search for jumps in one map of normals.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32 unit vectors.
    mask
        ``(H, W)`` bool.
    chords
        The chord rule.
    alternation
        The normals, as steps between pixels.
    evidence
        What they say about jumps.
    known
        Known heights, to which the pieces are moved; the normals decide where the surface jumps.
    """

    normals: Float32
    mask: Bool
    chords: ChordRule
    alternation: Alternation
    evidence: JumpEvidence
    known: Anchors | None = None

    @classmethod
    def of(
        cls,
        normals: Float32,
        mask: Bool,
        chords: ChordRule,
        edges: tuple[Float32, Float32, Float64, Float64],
        *,
        k: float,
        factors: Pair | None = None,
        least: float = 0.0,
    ) -> JumpProblem | None:
        """Return the problem of normals; None if the share of suspect edges is below the least.

        Parameters
        ----------
        normals, mask, chords
            As above.
        edges
            Weights and steps of the chord rule.
        k
            Sharpness of the sigmoid, in 1/px^2.
        factors
            ``(H+2, W+2)`` float32 factors of the weights, from the deviations of the normals.
        least
            Least share of suspect edges.
        """
        right, down, *steps = edges
        evidence = jump_evidence(
            normals,
            (right, down),
            (steps[0], steps[1]),
            chords.step_px,
            factors,
            chords.rays,
            ordered=mask.size <= _LARGEST_SEARCH,
        )
        if evidence.suspects < least:
            return None
        # Where the surface jumps, normals before and after an edge are not its own.
        own = steps[0].copy(), steps[1].copy()
        chords.correct(normals, evidence.sure((right, down)), own)
        alternation = Alternation(
            (right, down, own[0].astype(np.float32), own[1].astype(np.float32)),
            chords.facing(normals, mask),
            k,
            chords.step_px,
            factors,
            continuity=evidence.continuity,
        )
        return cls(normals, mask, chords, alternation, evidence)

    def near(self, u: Float64) -> JumpProblem:
        """Return the problem of a surface that is held weakly at another one everywhere."""
        right, down = self.alternation.edges[:2]
        weights = np.where(right + down > 0, _HELD, np.float32(0))
        return replace(self, alternation=replace(self.alternation, held=Anchors(weights, u)))

    def contradiction(self, u: Float64) -> float:
        """Return about the weight of the edges that a surface contradicts by half a pixel."""
        return self.alternation.contradiction(u, self.evidence)

    def improves(self, u: Float64, smooth: Float64, known: Anchors | None = None) -> bool:
        """Return whether a surface contradicts normals and heights less than a smooth one."""
        return self.alternation.improves(u, smooth, self.evidence, known)

    def solved(self, on_progress: Progress = no_progress) -> tuple[Solution, Jumps, Pair]:
        """Return the surface under the last weights, where it jumps, and these weights.

        The stage ``integrating`` of ``on_progress`` is in percent.
        """
        on_progress("integrating", 0, 100)
        found, iterations = self.found()
        on_progress("integrating", 100, 100)
        # That the rounds end before the surface stands still is reported by the jumps.
        converged = found.relative_residual <= TOLERANCE
        solution = Solution(found.u, iterations, found.relative_residual, converged=converged)
        moves = found.moved[self.alternation.facing != 0]
        moves = np.abs(moves - np.median(moves)) if moves.size else np.zeros(1)
        last_change = float(np.quantile(moves, _SETTLED_QUANTILE))
        del moves
        jumps = Jumps(
            *self.judged(found.u), found.rounds, last_change, settled=last_change < _SETTLED_PX
        )
        return solution, jumps, found.weights

    def found(self, coarse: CoarseSurface | None = None) -> tuple[Alternated, int]:
        """Return the surface after the last round, and the number of all iterations.

        Pieces of a large map are found and placed in one of half the size, unless a coarse surface
        is given.
        """
        if coarse is not None and coarse.cell == self.chords.cell:
            found = self._late(np.pad(coarse.u, 1))
            return found, found.iterations
        if coarse is None and self.mask.size <= _LARGEST_SEARCH:
            return self._searched()
        u, iterations = self._from_half(coarse)
        found = self._late(u)
        return found, iterations + found.iterations

    def judged(self, u: Float64) -> tuple[Bool, Bool, Float32, Int32]:
        """Return the jumps to the right and down, the doubt and the pieces of a surface."""
        problem = self.alternation
        apart = None
        if self.known is not None:
            right, down = (
                (each >= _CONTINUOUS).astype(np.float32) for each in self.evidence.continuity
            )
            apart = Basins.of(problem.edges[:2], (right, down)).pieces()
        return _judged(u, _JUMP_PX / problem.scale, problem.edges[:2], problem.trust(u), apart)

    def _trust(self, u: Float64) -> Pair:
        """Return how much both pixels of each edge trust each other, where normals do, too."""
        own, continuity = self.alternation.trust(u), self.evidence.continuity
        return own[0] * continuity[0], own[1] * continuity[1]

    def _searched(self) -> tuple[Alternated, int]:
        """Find pieces and place them, several times with resampled evidence, and once with all.

        Where the normals of both sides differ little, only abrupt turns of smoothed normals show a
        rim; elsewhere they are misleading. Of two searches, with and without them, the one with the
        less contradicted surface decides whether they count in the others.
        """
        starts = None, evenness(self.normals, self.mask, self.alternation.edges[:2])
        searches = [(*self.once(even), even) for even in starts]
        iterations = sum(spent for _, spent, _ in searches)
        best, _, even = min(searches, key=lambda search: self.contradiction(search[0].u))
        parts, count = label_parts(*self.alternation.edges[:2])
        known = np.zeros(count, bool)
        if self.known is not None:
            known[parts[self.known.weights > 0]] = True
        rng = np.random.default_rng(0)
        surfaces = [best.u]
        while len(surfaces) <= _SEARCHES:
            found, spent = self._resampled(rng).once(even)
            surfaces.append(found.u)
            iterations += spent
            if len(surfaces) == _FEWEST:
                _, apart = median_surface(surfaces, parts, known)
                if np.mean(self.alternation.scale * apart[parts >= 0] > _APART_PX) < _APART_SHARE:
                    break
        middle, _ = median_surface(surfaces, parts, known)
        typical = self._late(middle)
        iterations += typical.iterations
        # Its decisions hold unless those of all evidence are clearly better.
        if self.contradiction(best.u) > _CLEARLY * self.contradiction(typical.u):
            best = typical
        return best, iterations

    def _resampled(self, rng: np.random.Generator) -> JumpProblem:
        """Return the problem with random weights of the edges and of the evidence."""
        shape = self.alternation.facing.shape
        weights = random_weights((shape[0], shape[1]), rng)
        factors = self.alternation.factors
        both = (weights, weights)
        if factors is not None:
            both = factors[0] * weights, factors[1] * weights
        return replace(
            self,
            alternation=replace(self.alternation, factors=both),
            evidence=self.evidence.weighted(weights),
        )

    def once(self, even: Pair | None) -> tuple[Alternated, int]:
        """Compute surface and weights in turn, and place pieces; return also all iterations.

        Pieces move to where the edges between them agree, as long as fewer edges contradict the
        surface.

        Parameters
        ----------
        even
            ``(H+2, W+2)`` additional factors of the weights in the first rounds.
        """
        problem = self.alternation
        best = problem.solved(even)
        if self.known is not None:
            best = self._late(best.u)
        least, iterations = self.contradiction(best.u), best.iterations
        steps = problem.edges[2], problem.edges[3]
        for width in _WIDTHS_PX:
            trust = self._trust(best.u)
            found = self._late(placed(best.u, steps, self.evidence, trust, width, problem.scale))
            iterations += found.iterations
            contradiction = self.contradiction(found.u)
            if contradiction < least:
                best, least = found, contradiction
        return best, iterations

    def _late(self, u: Float64) -> Alternated:
        """Improve a surface in the last rounds, from where its pieces are at known heights."""
        if self.known is None:
            return self.alternation.solved(after=u)
        # Those of a larger map were moved in one of half the size.
        if self.mask.size <= _LARGEST_SEARCH:
            basins = Basins.of(self.alternation.edges[:2], self._trust(u))
            u = basins.moved(u, self.known.target, self.known.weights > 0)
        return self.near(u.copy()).alternation.solved(after=u)

    def _halved(self) -> JumpProblem:
        """Return the problem of a map of half the size."""
        problem, chords = self.alternation, self.chords.halved()
        normals, mask = mean_normals(self.normals * self.mask[..., None], 2)
        factors: Pair | None = None
        if problem.factors is not None:
            right, down = (_sums(each[1:-1, 1:-1]) for each in problem.factors)
            factors = np.pad(right / np.float32(4), 1), np.pad(down / np.float32(4), 1)
        # Pixels are larger, and so are steps of 1 / sqrt(k) of the smaller ones.
        half = JumpProblem.of(
            normals, mask, chords, chords.edges(normals, mask), k=4 * problem.k, factors=factors
        )
        if half is None:
            raise AssertionError("a problem without a least share of suspects exists")
        return replace(
            half,
            alternation=replace(half.alternation, held=self._anchors_of_half(problem.held)),
            known=self._anchors_of_half(self.known),
        )

    def _anchors_of_half(self, held: Anchors | None) -> Anchors | None:
        """Return the heights at which a map of half the size is held."""
        if held is None:
            return None
        weights = _sums(held.weights[1:-1, 1:-1])
        known = np.maximum(weights, np.finfo(np.float32).tiny)
        target = _sums(held.load[1:-1, 1:-1]) / (known * self.chords.halving)
        variance = held.variance / self.chords.halving**2
        return Anchors(np.pad(weights, 1), np.pad(target, 1), variance)

    def _from_half(self, coarse: CoarseSurface | None) -> tuple[Float64, int]:
        """Return the surface of a map of half the size, in all pixels, and the iterations."""
        half, iterations = self._halved().found(coarse)
        return self._refined(half.u), iterations

    def _refined(self, coarse: Float64) -> Float64:
        """Return the surface of the complete map from that of half the size."""
        rows, columns = self.mask.shape
        u = np.zeros((rows + 2, columns + 2))
        doubled = coarse[1:-1, 1:-1].repeat(2, axis=0).repeat(2, axis=1)
        u[1:-1, 1:-1] = self.chords.halving * doubled[:rows, :columns]
        # Within each square of four, half a step to either side.
        across = self.alternation.edges[2][1:-1, 1:-2:2] / 2
        u[1:-1, 1:-2:2] -= across
        u[1:-1, 2:-1:2] += across
        along = self.alternation.edges[3][1:-2:2, 1:-1] / 2
        u[1:-2:2, 1:-1] -= along
        u[2:-1:2, 1:-1] += along
        return u


def mean_normals(normals: Float32, cell: int) -> tuple[Float32, Bool]:
    """Return the mean normals of squares of pixels, and whether they are known; 0 where not.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32, 0 where a normal is not known.
    cell
        Side of the squares. The last ones may be incomplete.
    """
    sums = _sums(normals, cell)
    lengths = np.linalg.norm(sums, axis=2)
    mask: Bool = lengths > _LEAST_SUM
    means = np.where(mask[..., None], sums / np.maximum(lengths, _LEAST_SUM)[..., None], 0)
    return means.astype(np.float32), mask


def _sums(values: AnyArray, cell: int = 2) -> AnyArray:
    """Return the sums over squares of pixels, of which the last may be incomplete."""
    sides = [(0, -n % cell) for n in values.shape[:2]] + [(0, 0)] * (values.ndim - 2)
    whole = np.pad(values, sides)
    rows = sum(whole[k::cell] for k in range(1, cell)) + whole[::cell]
    sums: AnyArray = sum(rows[:, k::cell] for k in range(1, cell)) + rows[:, ::cell]
    return sums


def _judged(
    u: Float64, jump: float, edges: Pair, trust: Pair, apart: Int32 | None
) -> tuple[Bool, Bool, Float32, Int32]:
    """Find jumps above a height, doubt and pieces, each within one of other pieces, if given.

    The trust is changed.
    """
    inner = slice(1, -1), slice(1, -1)
    surface = linked(edges) > 0
    doubt = np.zeros(u.shape, np.float32)
    jumps = []
    for axis, (edge, confidence) in enumerate(zip(edges, trust, strict=True)):
        here, there = (np.s_[:, :-1], np.s_[:, 1:]) if axis == 0 else (np.s_[:-1], np.s_[1:])
        # Of pixels without an edge between them, the normals are opposed, or grazing.
        steep = np.abs(u[there] - u[here]) > jump
        jumped = np.zeros(u.shape, bool)
        jumped[here] = steep & surface[here] & surface[there] & (confidence[here] < _JUMP_TRUST)
        jumps.append(jumped[inner])
        little = np.where(edge[here] > 0, 1 - confidence[here], 0)
        np.maximum(doubt[here], little, out=doubt[here])
        np.maximum(doubt[there], little, out=doubt[there])
    doubt[~surface] = np.nan
    for axis, confidence in enumerate(trust):
        confidence[confidence <= _PIECE_TRUST] = 0
        if apart is not None:
            confidence[apart != np.roll(apart, -1, axis=1 - axis)] = 0
    labels, count = label_parts(*trust)
    pieces = _largest_first(labels[inner], count, int(np.count_nonzero(surface)))
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
