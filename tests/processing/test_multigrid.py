from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from processing.surface.grid_graph import apply_laplacian, divergence, label_parts
from processing.surface.multigrid import _cycle, coarsened, solve
from rig.arrays import Bool, Float32, Float64
from tests.processing.scenes import one_thread

Graph = tuple[Float32, Float32]


def graph(mask: Bool, seed: int | None = None, low: float = 0.0) -> Graph:
    """Return edges between the pixels of a mask, with weight 1 or random in 10^low .. 1."""
    rows, columns = mask.shape
    right, down = np.zeros((2, rows + 2, columns + 2), np.float32)
    right[1:-1, 1:-2] = mask[:, :-1] & mask[:, 1:]
    down[1:-2, 1:-1] = mask[:-1] & mask[1:]
    if seed is not None:
        rng = np.random.default_rng(seed)
        right *= 10 ** rng.uniform(low, 0, right.shape).astype(np.float32)
        down *= 10 ** rng.uniform(low, 0, down.shape).astype(np.float32)
    return right, down


def steps(u: Float64) -> tuple[Float64, ...]:
    step_right, step_down = np.zeros((2, *u.shape))
    step_right[:, :-1] = np.diff(u, axis=1)
    step_down[:-1] = np.diff(u, axis=0)
    return step_right, step_down


def matrix(right: Float32, down: Float32) -> sparse.csr_array:
    node = np.arange(right.size).reshape(right.shape)
    i = np.concatenate([node[:, :-1].ravel(), node[:-1].ravel()])
    j = np.concatenate([node[:, 1:].ravel(), node[1:].ravel()])
    w = np.concatenate([right[:, :-1].ravel(), down[:-1].ravel()]).astype(np.float64)
    i, j, w = i[w > 0], j[w > 0], w[w > 0]
    adjacency = sparse.coo_array((w, (i, j)), (right.size, right.size))
    return sparse.csr_array(adjacency + adjacency.T)


@settings(max_examples=25)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 25),
    st.integers(1, 25),
    st.floats(0.3, 1.0),
    st.floats(-3, 0),
)
def test_solves_any_weighted_graph(
    seed: int, rows: int, columns: int, full: float, low: float
) -> None:
    rng = np.random.default_rng(seed)
    mask = rng.random((rows, columns)) < full
    right, down = graph(mask, seed, low)
    truth = np.cumsum(rng.normal(size=right.shape), axis=1) * 10 ** rng.uniform(-6, 6)
    labels, count = label_parts(right, down)
    adjacency = matrix(right, down)
    expected, parts = connected_components(adjacency, directed=False)
    alone = np.bincount(parts, minlength=expected) == 1
    assert count == expected - alone.sum()
    solution = solve(right, down, divergence(right, down, *steps(truth)), tolerance=1e-9)
    assert solution.converged
    for part in range(count):
        inside = labels == part
        assert len(np.unique(parts.reshape(labels.shape)[inside])) == 1
        off = (solution.u - truth)[inside]
        assert np.abs(off - off.mean()).max() <= 1e-5 * np.ptp(truth[inside])
    assert not solution.u[labels < 0].any()


@pytest.mark.parametrize("size", [(40, 40), (31, 57), (1, 90), (5, 4)])
@pytest.mark.parametrize("held", [False, True])
def test_the_cycle_is_symmetric(size: tuple[int, int], held: bool) -> None:
    """Conjugate gradients require it, and the sums of one colour's residual rely on the other."""
    rng = np.random.default_rng(sum(size))
    right, down = graph(rng.random(size) < 0.8, 3, -1)
    labels, count = label_parts(right, down)
    anchors = None
    if held:
        anchors = np.where(labels >= 0, rng.random(labels.shape), 0).astype(np.float32)
    vectors = np.where(labels >= 0, rng.normal(size=(2, *labels.shape)), 0)
    for part in range(0 if held else count):
        vectors[:, labels == part] -= vectors[:, labels == part].mean(axis=1, keepdims=True)
    levels = coarsened(right, down, anchors)
    one, other = (_cycle(levels, vector).astype(np.float64) for vector in vectors)
    size_of = np.linalg.norm(one) * np.linalg.norm(vectors[1])
    assert np.vdot(vectors[1], one) == pytest.approx(np.vdot(vectors[0], other), abs=1e-5 * size_of)
    assert np.vdot(vectors[0], one) > 0


def test_inconsistent_steps_are_solved_by_least_squares() -> None:
    rng = np.random.default_rng(1)
    right, down = graph(rng.random((23, 31)) < 0.8, 1, -2)
    step_right, step_down = rng.normal(size=(2, *right.shape))
    b = divergence(right, down, step_right, step_down)
    laplacian = matrix(right, down)
    laplacian = sparse.diags_array(laplacian.sum(axis=1)) - laplacian
    expected = np.linalg.lstsq(laplacian.toarray(), b.ravel(), rcond=1e-12)[0].reshape(b.shape)
    solution = solve(right, down, b, tolerance=1e-10)
    labels, count = label_parts(right, down)
    for part in range(count):
        off = (solution.u - expected)[labels == part]
        assert np.ptp(off) < 1e-6
    # The operator equals the matrix.
    u, out = rng.normal(size=right.shape), np.zeros(right.shape)
    inner = np.zeros(right.shape, bool)
    inner[1:-1, 1:-1] = True
    u[~inner] = 0
    energy = apply_laplacian(right, down, u, out).sum()
    np.testing.assert_allclose(
        out[inner], (laplacian @ u.ravel()).reshape(u.shape)[inner], atol=1e-12
    )
    assert energy == pytest.approx(float((u * out).sum()))


def waves(size: tuple[int, int]) -> Float64:
    y, x = np.meshgrid(*(np.linspace(-1, 1, n + 2) for n in size), indexing="ij")
    return 100 * (np.sin(3 * x) * np.cos(2 * y) + x)


def disc(n: int) -> Bool:
    y, x = np.mgrid[-1 : 1 : n * 1j, -1 : 1 : n * 1j]
    return (x**2 + y**2 < 0.9) & ((x - 0.2) ** 2 + (y - 0.3) ** 2 > 0.02)


def serpentine(n: int) -> Bool:
    mask = np.ones((n, n), bool)
    mask[3::8, 3:] = False
    mask[7::8, :-3] = False
    return mask


def maze(cells: int, wide: int) -> Bool:
    """Return the passages between walls of one pixel, without loops (depth-first search)."""
    rng, pitch = np.random.default_rng(5), wide + 1
    mask = np.zeros((cells * pitch + 1,) * 2, bool)
    mask[1:, 1:] = (np.indices(np.array(mask.shape) - 1) % pitch < wide).all(axis=0)
    path, seen = [(0, 0)], {(0, 0)}
    while path:
        r, c = path[-1]
        near = [(r, c + 1), (r + 1, c), (r, c - 1), (r - 1, c)]
        near = [(q, d) for q, d in near if min(q, d) >= 0 and max(q, d) < cells]
        near = [cell for cell in near if cell not in seen]
        if not near:
            path.pop()
            continue
        q, d = near[rng.integers(len(near))]
        top, left = 1 + min(q, r) * pitch, 1 + min(d, c) * pitch
        mask[top : top + wide + (q != r), left : left + wide + (d != c)] = True
        path.append((q, d))
        seen.add((q, d))
    return mask


@pytest.mark.parametrize("wide", [1, 2])
@pytest.mark.parametrize("seed", [None, 3], ids=["even weights", "uneven weights"])
def test_mazes_are_solved(wide: int, seed: int | None) -> None:
    mask = maze(60, wide)
    mask[:, 60] = False  # several parts
    right, down = graph(mask, seed, -2)
    truth = waves(mask.shape)
    solution = solve(right, down, divergence(right, down, *steps(truth)))
    assert solution.converged
    assert solution.iterations <= 30
    labels, count = label_parts(right, down)
    assert count > 1
    offsets = (solution.u - truth)[labels >= 0]
    members = labels[labels >= 0]
    means = np.bincount(members, offsets) / np.bincount(members)
    assert np.abs(offsets - means[members]).max() < 1e-6 * np.ptp(truth)


@pytest.mark.parametrize(
    ("mask", "seed", "iterations"),
    [
        pytest.param(np.ones((257, 400), bool), None, 10, id="full frame"),
        pytest.param(disc(400), None, 10, id="disc with a hole"),
        pytest.param(disc(400), 3, 30, id="uneven weights"),
        pytest.param(np.ones((1, 3000), bool), None, 10, id="one row"),
        pytest.param(np.ones((3000, 2), bool), None, 20, id="two columns"),
        pytest.param(serpentine(200), None, 200, id="serpentine"),
    ],
)
def test_a_few_iterations_suffice(mask: Bool, seed: int | None, iterations: int) -> None:
    right, down = graph(mask, seed, -2)
    truth = waves(mask.shape)
    solution = solve(right, down, divergence(right, down, *steps(truth)))
    assert solution.converged
    assert solution.relative_residual <= 1e-6
    assert solution.iterations <= iterations
    off = (solution.u[1:-1, 1:-1] - truth[1:-1, 1:-1])[mask]
    assert np.ptp(off) < 1e-3 * np.ptp(truth)


def test_the_iterations_do_not_grow_with_the_image() -> None:
    counts = []
    for n in (100, 200, 400):
        right, down = graph(disc(n))
        b = divergence(right, down, *steps(waves((n, n))))
        counts.append(solve(right, down, b).iterations)
    assert max(counts) <= min(counts) + 3


def test_the_answer_does_not_depend_on_the_threads() -> None:
    right, down = graph(disc(300), 2, -1)
    b = divergence(right, down, *steps(waves((300, 300))))
    with one_thread():
        alone = solve(right, down, b).u
    np.testing.assert_array_equal(solve(right, down, b).u, alone)


def test_nothing_to_solve() -> None:
    right, down = graph(np.ones((5, 5), bool))
    solution = solve(right, down, np.zeros(right.shape))
    assert solution.converged
    assert solution.iterations == 0
    assert not solution.u.any()


@pytest.mark.parametrize("size", [2, 3, 10, 40])
@pytest.mark.parametrize("seed", range(5))
def test_a_tolerance_below_the_rounding_errors_does_no_harm(size: int, seed: int) -> None:
    right, down = graph(np.ones((size, size), bool), seed, -2)
    true = np.random.default_rng(seed).normal(size=right.shape)
    b = divergence(right, down, *steps(true))
    solution = solve(right, down, b, tolerance=0.0)
    assert solution.iterations < 500
    assert solution.relative_residual < 1e-10
    error = (solution.u - true)[1:-1, 1:-1]
    assert np.ptp(error) < 1e-9


@pytest.mark.parametrize("low", [-1, -4])
def test_an_accuracy_is_that_of_the_heights(low: float) -> None:
    """Also with weights down to 1e-4, where a small residual does not mean a small error."""
    right, down = graph(disc(96), 5, low)
    noise = np.random.default_rng(5).normal(size=(2, *right.shape))
    b = divergence(right, down, noise[0], noise[1])
    exact = solve(right, down, b, tolerance=1e-13)
    some = solve(right, down, b, tolerance=1e-13, accuracy=1e-3)
    labels = label_parts(right, down)[0]
    inside = labels >= 0
    off = (some.u - exact.u)[inside]
    means = np.bincount(labels[inside], off) / np.bincount(labels[inside])
    assert np.abs(off - means[labels[inside]]).max() < 1e-3
    assert some.converged
    assert some.iterations < exact.iterations


def test_a_solver_without_convergence_reports_it() -> None:
    right, down = graph(disc(100), 4, -3)
    b = divergence(right, down, *steps(waves((100, 100))))
    solution = solve(right, down, b, max_iterations=2)
    assert not solution.converged
    assert solution.iterations == 2
    assert solution.relative_residual > 1e-6


@settings(max_examples=20)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(2, 25),
    st.integers(2, 25),
    st.floats(-5, 5),
    st.sampled_from([0.02, 0.3, 1.0]),
)
def test_anchors_hold_their_parts(
    seed: int, rows: int, columns: int, strength: float, share: float
) -> None:
    """Weak and fixed heights at few or all pixels, against elimination."""
    rng = np.random.default_rng(seed)
    right, down = graph(rng.random((rows, columns)) < 0.9, seed, -2)
    labels, count = label_parts(right, down)
    inside = labels >= 0
    anchors = np.where(inside & (rng.random(labels.shape) < share), 10**strength, 0)
    # At least one in each part: then the matrix is regular.
    anchors.ravel()[[np.flatnonzero(labels == part)[0] for part in range(count)]] = 10**strength
    anchors = anchors.astype(np.float32)
    target = np.where(anchors > 0, rng.normal(size=labels.shape), 0)
    b = divergence(right, down, *steps(rng.normal(size=labels.shape))) + anchors * target
    found = solve(right, down, b, anchors=anchors, tolerance=1e-12)
    edges = matrix(right, down)
    diagonal = np.asarray(edges.sum(axis=1)).ravel() + anchors.ravel()
    system = (sparse.diags_array(diagonal) - edges).toarray()
    kept = np.flatnonzero(inside)
    expected = np.zeros(labels.size)
    expected[kept] = np.linalg.solve(system[np.ix_(kept, kept)], b.ravel()[kept])
    size = np.abs(expected).max() if len(kept) else 0
    np.testing.assert_allclose(found.u.ravel(), expected, atol=1e-5 * size)
