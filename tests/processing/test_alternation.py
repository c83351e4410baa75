"""Weights and surface in turn, on steps whose surfaces are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from processing.surface import alternation
from processing.surface.alternation import Alternation
from processing.surface.anchors import Anchors
from processing.surface.grid_graph import divergence
from processing.surface.jump_evidence import JumpEvidence
from processing.surface.multigrid import solve
from rig.arrays import Float64

ROWS, COLUMNS = 24, 30
SLOPE = 0.4


def plane(scale: float = 1.0) -> tuple[Alternation, Float64]:
    """Return the problem of a plane that rises to the right, and its heights in pixels."""
    right, down = np.zeros((2, ROWS + 2, COLUMNS + 2), np.float32)
    right[1:-1, 1:-2], down[1:-2, 1:-1] = 1, 1
    to_right, to_down = np.zeros((2, ROWS + 2, COLUMNS + 2))
    to_right[1:-1, 1:-2] = SLOPE / scale
    facing = np.zeros_like(right)
    facing[1:-1, 1:-1] = 1 / np.hypot(1, SLOPE)
    heights = np.zeros((ROWS + 2, COLUMNS + 2))
    heights[1:-1, 1:-1] = SLOPE * np.arange(COLUMNS)
    problem = Alternation((right, down, to_right, to_down), facing, 4.0, scale)
    return problem, heights


def within(u: Float64) -> Float64:
    inner = u[1:-1, 1:-1]
    return inner - inner.mean()


@pytest.mark.parametrize("scale", [1.0, 500.0])
def test_a_plane_needs_no_round_after_the_gate_is_narrow(scale: float) -> None:
    problem, heights = plane(scale)
    found = problem.solved()
    np.testing.assert_allclose(within(scale * found.u), within(heights), atol=0.02)
    # The turn of the normals counts in 10 rounds; the next one changes nothing.
    assert found.rounds == 11
    assert np.abs(found.moved).max() < 0.01
    assert found.relative_residual < 0.01
    assert found.width == pytest.approx(8 * 0.02)
    # Both pixels trust each other: the weight is the squared cosine.
    np.testing.assert_allclose(found.weights[0][1:-1, 2:-3], 1 / (1 + SLOPE**2), rtol=1e-2)


def test_the_contradiction_counts_edges_that_differ() -> None:
    problem, heights = plane()
    right, down = problem.edges[:2]
    none = np.zeros_like(right), np.zeros_like(down)
    evidence = JumpEvidence((right, down), (right, np.float32(0.5) * down), none, 0.0, 0.0)
    assert problem.contradiction(heights, evidence) == pytest.approx(0, abs=1e-12)
    jump = heights.copy()
    jump[1:-1, 11:-1] += 3
    assert problem.contradiction(jump, evidence) == pytest.approx(ROWS * 9 / 9.25)
    # What hides the left side is too high.
    ordered = evidence._replace(order=(right, none[1]))
    assert problem.contradiction(jump, ordered) == pytest.approx(2 * ROWS * 9 / 9.25)
    ordered = evidence._replace(order=(-right, none[1]))
    assert problem.contradiction(jump, ordered) == pytest.approx(ROWS * 9 / 9.25)
    jump = heights.copy()
    jump[11:-1] += 0.5
    assert problem.contradiction(jump, evidence) == pytest.approx(0.5 * COLUMNS / 2)
    larger = replace(problem, scale=2.0)
    assert larger.contradiction(heights / 2, evidence) > 1


def test_a_surface_is_improved_in_few_rounds() -> None:
    problem, heights = plane()
    rough = heights + 0.3 * np.random.default_rng(4).normal(size=heights.shape)
    found = problem.solved(after=rough)
    np.testing.assert_allclose(within(found.u), within(heights), atol=0.02)
    assert found.rounds <= 6


def test_edges_that_contradict_the_others_end_with_the_least_weight() -> None:
    """Along a short seam, the steps are wrong by 5 px; other edges go around it."""
    problem, heights = plane()
    problem.edges[2][9:15, 15] += 5
    found = problem.solved()
    np.testing.assert_allclose(within(found.u), within(heights), atol=0.5)
    usual = np.median(found.weights[0][1:-1, 1:-2])
    assert np.all(found.weights[0][10:14, 15] < 0.05 * usual)


def test_factors_multiply_weights_and_heights_hold_the_surface() -> None:
    problem, heights = plane()
    factors = np.full_like(problem.facing, 0.25), np.full_like(problem.facing, 0.25)
    weights, target = np.zeros_like(problem.facing), np.zeros(problem.facing.shape)
    weights[5, 5], target[5, 5] = 10, 77
    held = replace(problem, factors=factors, held=Anchors(weights, target))
    found, free = held.solved(), problem.solved()
    assert found.u[5, 5] == pytest.approx(77, abs=0.05)
    np.testing.assert_allclose(within(found.u), within(heights), atol=0.05)
    np.testing.assert_allclose(found.weights[1], 0.25 * free.weights[1], rtol=1e-2, atol=1e-6)


def test_the_gate_narrows_from_the_residuals_of_the_first_surface(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Wrong steps of thousands of pixels, in a part of its own: the others stay consistent."""
    monkeypatch.setattr(alternation, "TOLERANCE", 1e-8)
    monkeypatch.setattr(alternation, "_ITERATIONS", 50)
    problem, _ = plane()
    problem.edges[0][:, 25] = 0
    problem.edges[2][1:-1, 26:-2] += np.random.default_rng(5).normal(0, 5000, (ROWS, COLUMNS - 26))
    found = problem.solved()
    # Without a surface, all edges are trusted: their weights are equal.
    right, down = (edges / np.float32(1 + SLOPE**2) for edges in problem.edges[:2])
    b = divergence(right, down, *problem.edges[2:])
    first = solve(right, down, b, tolerance=1e-8, max_iterations=50)
    residuals = problem._residuals(first.u)
    assert found.rounds == 15
    assert found.width == pytest.approx(0.7**13 * problem._spread(residuals)[1], rel=1e-3)


def test_the_least_weight_grows_with_the_square_of_the_noise() -> None:
    problem, heights = plane()
    rng = np.random.default_rng(6)
    for steps, edges in zip(problem.edges[2:], problem.edges[:2], strict=True):
        steps += 0.01 * rng.normal(size=steps.shape) * (edges > 0)
    # Known heights, with a jump that the steps do not show. Of its two pixels, the first has no
    # other neighbour in its row: it does not distrust the edge.
    known = np.where(problem.facing > 0, np.float32(1000), np.float32(0))
    heights[1:-1, 2:-1] += 20
    held = replace(problem, held=Anchors(known, heights))
    found = held.solved()
    np.testing.assert_allclose(found.u, heights, atol=0.05)
    least = found.weights[0][1:-1, 1] * (1 + SLOPE**2)
    np.testing.assert_allclose(least, 0.5 * 0.03 * 0.5**2, rtol=0.2)


def test_a_round_has_twelve_iterations_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(alternation, "TOLERANCE", 0.0)
    problem, _ = plane()
    problem.edges[2][9:15, 15] += 5
    found = problem.solved()
    # Rounding errors may end one of them.
    assert 12 * found.rounds - 3 <= found.iterations <= 12 * found.rounds
