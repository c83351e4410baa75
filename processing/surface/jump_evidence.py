"""What normals alone say about jumps in depth between neighbouring pixels.

Two things betray a jump. The normals of both sides differ, and the steps around four pixels do not
add up to 0, because those across the jump are wrong (the curl of the slopes). Either is weak: the
normals differ at a crease, too, and the curl is small where a jump has the same height for some
pixels. Together, they distinguish jumps from smooth surfaces and from noise.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from rig.arrays import Float32, Float64, Int64
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

Pair = tuple[Float32, Float32]

# The odds of a jump are (turn + _TURN_DEG) (curl + _CURL_PX)^(4/3) / _EVEN, with the turn of the
# normals in degrees and the curl in pixels: a fit to simulated scenes.
_TURN_DEG, _CURL_PX, _EVEN = 3.0, 0.05, 50.0
# An edge with a lower probability of being continuous is suspect.
SURE = 0.95
# Turns up to this multiple of the median turn of the map, and curls up to this number of their
# standard deviations, may be noise.
_USUAL_TURNS, _USUAL_CURLS = 1.5, 3.0
# Median turn in rad by the noise of neighbours, relative to the deviation of an edge in pixels.
_TURN_BY_NOISE = 2.35
# Sides in pixels of the squares whose sums of steps show the noise. Noise that neighbouring pixels
# share, as after compression or enlargement, is seen only around larger squares. Jumps cross many
# of those: their noise is that of this share of the squares, with the smallest sums, for which a
# normal distribution has this deviation.
_SIDES = (1, 2, 4, 8)
_QUIET, _QUIET_DEVIATION = 0.1, 0.12566
# Noise is shared if it is this many times as large around some squares as around pixels.
_SHARED = 1.5
# Shared noise up to this multiple of the usual number of deviations is no rim: the share of noise
# beyond it is that of suspect edges without jumps.
_TOGETHER = 1.4
# The curl is small where a jump has the same height for some pixels: that of this many more pixels
# along the rim counts.
_REACH = 2
# Normals that turn by this angle: the step between them is a quarter as good a witness of heights.
_WITNESS_DEG = 20.0
# From the median of absolute values to a standard deviation.
_MEDIAN_TO_SIGMA = 1.4826
# About as many values have a median that is good enough.
_SAMPLES = 200_000


class JumpEvidence(NamedTuple):
    """The evidence of all edges.

    Parameters
    ----------
    continuity
        ``(H+2, W+2)`` float32 probabilities that the edges to the right and down are continuous,
        1 without an edge.
    witness
        ``(H+2, W+2)`` float32 weights of their steps as witnesses of relative heights: those of the
        chord rule, times the probabilities, less where the normals turn.
    order
        ``(H+2, W+2)`` float32 -1..1 weights against larger (positive) or smaller (negative) steps:
        where the surface jumps, the pixel whose normal leans towards the other hides what is
        behind it. Empty if it is not wanted.
    suspects
        Share of the edges that are suspect.
    noise_px
        Standard deviation of an edge of weight 1, in pixels: that of white noise which adds up over
        long distances as the noise of the map does.
    """

    continuity: Pair
    witness: Pair
    order: Pair
    suspects: float
    noise_px: float

    def sure(self, edges: Pair) -> tuple[Float32, Float32]:
        """Return the weights of edges, 0 for those that are suspect."""
        right, down = (
            np.where(probability >= SURE, edge, np.float32(0))
            for probability, edge in zip(self.continuity, edges, strict=True)
        )
        return right, down

    def weighted(self, weights: Float32) -> JumpEvidence:
        """Return the evidence with ``(H+2, W+2)`` weights of its edges."""
        witness, order = (
            (right * weights, down * weights) for right, down in (self.witness, self.order)
        )
        return self._replace(witness=witness, order=order)


def jump_evidence(
    normals: Float32,
    edges: Pair,
    steps: tuple[Float64, Float64],
    step_px: float,
    factors: Pair | None = None,
    rays: Float64 | None = None,
    *,
    ordered: bool = True,
) -> JumpEvidence:
    """Return what normals say about jumps.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32 unit vectors.
    edges, steps
        ``(H+2, W+2)`` weights of the edges to the right and down, and steps of the chord rule.
    step_px
        Pixels for a step of 1.
    factors
        ``(H+2, W+2)`` factors of the weights, from the deviations of the normals.
    rays
        ``(H, W, 3)`` directions of the pixels from the camera; None for an orthographic view.
    ordered
        Whether the order is wanted, which only votes on the heights of pieces.
    """
    known = edges if factors is None else (edges[0] * factors[0], edges[1] * factors[1])
    curls, spreads = _curls(known[0], known[1], steps[0], steps[1], step_px)
    turns = _turns(normals, edges[0], 0), _turns(normals, edges[1], 1)
    sparse = max(1, math.isqrt(curls.size // _SAMPLES))
    some = np.s_[::sparse, ::sparse]
    noise_px, at_once = _noise(known, steps, step_px, sparse)
    noise = _USUAL_CURLS * at_once
    turned = [turn[some][edge[some] > 0] for turn, edge in zip(turns, edges, strict=True)]
    usual = max(_median(np.concatenate(turned)), math.degrees(_TURN_BY_NOISE * at_once))
    usual *= _USUAL_TURNS
    suspects = 0
    witness = edges[0].copy(), edges[1].copy()
    for axis in (0, 1):
        # The turns become probabilities.
        found = _judge(edges[axis], curls, spreads, axis, usual, noise, turns[axis], witness[axis])
        suspects += int(found.sum())
    count = int(np.count_nonzero(edges[0])) + int(np.count_nonzero(edges[1]))
    seen = np.zeros((0, 0, 3)) if rays is None else rays
    order = np.zeros((0, 0), np.float32), np.zeros((0, 0), np.float32)
    if ordered:
        order = _order(normals, seen, turns[0], 0), _order(normals, seen, turns[1], 1)
    return JumpEvidence(turns, witness, order, suspects / max(count, 1), noise_px)


def _noise(
    edges: Pair, steps: tuple[Float64, Float64], step_px: float, sparse: int
) -> tuple[float, float]:
    """Return the deviations of edges of weight 1, over long distances and of single pixels, px.

    With noise of independent normals, the sum of the steps around a square of n pixels has a
    variance that is (2 n - 1) times that of one pixel. If the normals of larger parts have the same
    error, the sum grows as n up to the size of these parts.
    """
    far = near = single = 0.0
    for side in _SIDES:
        sums = _loops(*edges, *steps, side, sparse)
        sums = step_px * sums[np.isfinite(sums)]
        deviation = _MEDIAN_TO_SIGMA * _median(sums)
        if side > 1 and sums.size:
            deviation = float(np.quantile(sums, _QUIET)) / _QUIET_DEVIATION
        far = max(far, deviation * math.sqrt(side / (2 * side - 1)))
        near = max(near, deviation / math.sqrt(side))
        single = single or far
    if far < _SHARED * single:
        return single, single
    # Large deviations of shared noise come together, and are sooner taken for a rim.
    return far, near * _TOGETHER


def _median(values: Float32 | Float64) -> float:
    return float(np.median(values)) if values.size else 0.0


@numba.njit(parallel=True, cache=True)
def _loops(
    right: Float32, down: Float32, to_right: Float64, to_down: Float64, side: int, sparse: int
) -> Float64:
    """Return absolute sums of the steps around some squares, NaN without one of their edges.

    They are relative to the root of their variance for edges with independent errors of 1.
    """
    rows, columns = right.shape
    out = np.full((-(-rows // sparse), -(-columns // sparse)), np.nan)
    for i in numba.prange(max(-(-(rows - side) // sparse), 0)):
        for j in range(max(-(-(columns - side) // sparse), 0)):
            r, c = i * sparse, j * sparse
            total = variance = 0.0
            for k in range(side):
                upper, lower = right[r, c + k], right[r + side, c + k]
                here, beside = down[r + k, c], down[r + k, c + side]
                if min(min(upper, lower), min(here, beside)) <= 0:
                    variance = np.nan
                    break
                variance += 1 / upper + 1 / lower + 1 / here + 1 / beside
                total += to_right[r, c + k] - to_right[r + side, c + k]
                total += to_down[r + k, c + side] - to_down[r + k, c]
            out[i, j] = abs(total) / math.sqrt(variance)
    return out


@numba.njit(parallel=True, cache=True)
def _curls(
    right: Float32, down: Float32, to_right: Float64, to_down: Float64, step_px: float
) -> tuple[Float32, Float32]:
    """Return absolute sums of the steps around each pixel and the next ones, in pixels.

    The second map has their standard deviations for normals with an error of 1; 0 without a sum.
    """
    rows, columns = right.shape
    curls = np.zeros((rows, columns), np.float32)
    spreads = np.zeros((rows, columns), np.float32)
    for r in numba.prange(rows - 1):
        for c in range(columns - 1):
            upper, lower = right[r, c], right[r + 1, c]
            here, next_ = down[r, c], down[r, c + 1]
            if min(min(upper, lower), min(here, next_)) > 0:
                total = to_right[r, c] + to_down[r, c + 1] - to_right[r + 1, c] - to_down[r, c]
                curls[r, c] = step_px * abs(total)
                spreads[r, c] = math.sqrt(1 / upper + 1 / lower + 1 / here + 1 / next_)
    return curls, spreads


@numba.njit(parallel=True, cache=True)
def _turns(normals: Float32, edges: Float32, vertical: int) -> Float32:
    """Return the angle between both normals of each edge, in degrees; 0 without an edge."""
    rows, columns = edges.shape
    out = np.zeros((rows, columns), np.float32)
    for r in numba.prange(1, rows - 1):
        for c in range(1, columns - 1):
            if edges[r, c] > 0:
                chord2 = 0.0
                for k in range(3):
                    near = normals[r - 1, c - 1, k]
                    chord2 += (normals[r - 1 + vertical, c - vertical, k] - near) ** 2
                out[r, c] = math.degrees(2 * math.asin(min(math.sqrt(chord2) / 2, 1.0)))
    return out


@numba.njit(**PART)
def _lean(normals: Float32, rays: Float64, r: int, c: int, vertical: int) -> float:
    """Return the part of a normal that points to the right (down) in the image."""
    x, y, z = float(normals[r, c, 0]), float(normals[r, c, 1]), float(normals[r, c, 2])
    if len(rays) == 0:
        return -y if vertical else x
    # The direction in the image that is at right angles to the line of sight.
    sight = rays[r, c]
    length2 = sight[0] ** 2 + sight[1] ** 2 + sight[2] ** 2
    along = -sight[1] if vertical else sight[0]
    facing = x * sight[0] + y * sight[1] + z * sight[2]
    lean = (-y if vertical else x) - along * facing / length2
    right_angled: float = lean / math.sqrt(1 - along**2 / length2)
    return right_angled


@numba.njit(parallel=True, cache=True)
def _order(normals: Float32, rays: Float64, continuity: Float32, vertical: int) -> Float32:
    """Return the weights against larger steps; negative: against smaller ones."""
    rows, columns = continuity.shape
    # Of logarithms of depths, the larger one is behind.
    upward = 1 if len(rays) == 0 else -1
    out = np.zeros((rows, columns), np.float32)
    for r in numba.prange(1, rows - 1):
        for c in range(1, columns - 1):
            if continuity[r, c] < 1:
                # Where a rounded part ends, its normal leans towards what it hides.
                here = max(_lean(normals, rays, r - 1, c - 1, vertical), 0.0)
                q, d = r - 1 + vertical, c - vertical
                there = max(-_lean(normals, rays, q, d, vertical), 0.0)
                out[r, c] = upward * (1 - continuity[r, c]) * (here**4 - there**4)
    return out


@numba.njit(parallel=True, cache=True)
def _judge(
    edges: Float32,
    curls: Float32,
    spreads: Float32,
    vertical: int,
    usual: float,
    noise: float,
    turns: Float32,
    witness: Float32,
) -> Int64:
    """Replace turns by probabilities, lessen the witness, and count the suspects of each row."""
    rows, columns = edges.shape
    suspects = np.zeros(rows, np.int64)
    for r in numba.prange(rows):
        for c in range(columns):
            turn2 = max(float(turns[r, c]) ** 2 - usual * usual, 0.0)
            turns[r, c] = 1
            if edges[r, c] <= 0:
                continue
            # The sums next to the edge, and those further along the rim.
            largest = 0.0
            for along in range(-1 - _REACH, 1 + _REACH):
                q, d = r + along * (1 - vertical), c + along * vertical
                if 0 <= q < rows and 0 <= d < columns:
                    own = float(curls[q, d]) ** 2 - (noise * spreads[q, d]) ** 2
                    largest = max(largest, own)
            curl = math.sqrt(largest)
            odds = (math.sqrt(turn2) + _TURN_DEG) * (curl + _CURL_PX) ** (4 / 3) / _EVEN
            turns[r, c] = 1 / (1 + odds)
            witness[r, c] = edges[r, c] * turns[r, c] / (1 + turn2 / _WITNESS_DEG**2) ** 2
            suspects[r] += turns[r, c] < SURE
    return suspects
