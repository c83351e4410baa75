"""The mesh-based peers, on surfaces with a known result."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmarks.paper.peers import bilaplacian
from benchmarks.paper.peers.bilaplacian import Bilaplacian
from benchmarks.paper.peers.dspl import Displacement
from benchmarks.paper.peers.lapl import LaplacianEditing, superlu
from benchmarks.paper.peers.mesh import GridMesh
from benchmarks.paper.peers.surfaces import MeshTask
from benchmarks.paper.sources import bowl
from processing import ShapeFilter, height_mesh, integrate

DIRECT = partial(LaplacianEditing, factorise=superlu)
PEERS = [
    pytest.param(Displacement, id="DSPL"),
    pytest.param(LaplacianEditing, id="LAPL"),
    pytest.param(DIRECT, id="LAPL, direct"),
]
SIDE = 60


def square(side: int = SIDE) -> GridMesh:
    number = np.arange(side * side, dtype=np.int32).reshape(side, side)
    a, b, d, e = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    faces = np.concatenate(
        [np.stack([a, d, b], axis=-1).reshape(-1, 3), np.stack([b, d, e], axis=-1).reshape(-1, 3)]
    )
    return GridMesh(np.ones((side, side), np.bool_), faces)


MESH = square()
# In unit steps, y up.
Y, X = (values.ravel() for values in np.mgrid[SIDE - 1 : -1 : -1, 0:SIDE].astype(np.float32))
FLAT = np.stack([X, Y, np.zeros_like(X)], axis=1)
# Vertices that the border does not affect through two smoothings.
INNER = (np.minimum(X, Y) >= 20) & (np.maximum(X, Y) < SIDE - 20)


def surface(height: np.ndarray) -> np.ndarray:
    return np.stack([X, Y, height], axis=1).astype(np.float32)


WAVES = (0.6 * np.sin(2 * np.pi * X / 6) * np.cos(2 * np.pi * Y / 6)).astype(np.float32)
BENT = surface(0.01 * (X - 30) ** 2 - 0.004 * (Y - 20) ** 2)


def transferred(make, source, target, **options):
    return make(MeshTask(target, MESH, **options)).put(source)


def test_the_base_is_the_papers_gaussian():
    impulse = ((X == 30) & (Y == 30)).astype(np.float32)[:, None]
    for w in (3, 5, 10):
        spread = MESH.base(impulse, w)[:, 0].reshape(SIDE, SIDE)
        kernel = ShapeFilter("gaussian", 1, w)._kernel
        whole = np.concatenate([kernel[:0:-1], kernel])
        there = spread[29 - w : 30 + w, 30 - w : 31 + w]
        np.testing.assert_allclose(there, np.outer(whole, whole), atol=1e-6)
        assert spread.sum() == pytest.approx(1, abs=1e-5)


def test_a_plane_is_its_own_base_inside_and_all_of_a_constant():
    plane = surface(0.4 * X - 0.3 * Y + 7)
    np.testing.assert_allclose(MESH.base(plane, 5)[INNER], plane[INNER], atol=1e-4)
    constant = np.full((SIDE**2, 2), 3, np.float32)
    np.testing.assert_allclose(MESH.base(constant, 5), constant, atol=1e-5)


def test_normals_of_a_tilted_plane_are_exact():
    normals = MESH.normals(surface(0.5 * X - 0.2 * Y))
    expected = np.tile([-0.5, 0.2, 1] / np.sqrt(1.29), (SIDE**2, 1))
    np.testing.assert_allclose(normals, expected, atol=1e-5)


def test_normals_are_weighted_by_area_and_a_vertex_without_a_face_has_z():
    # At vertex 0, one face in the plane z=0 and one of twice its area in the plane x=0.
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 2], [9, 9, 9]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    normals = GridMesh(np.ones((1, 5), np.bool_), faces).normals(vertices)
    np.testing.assert_allclose(normals[0], np.array([2, 0, 1]) / np.sqrt(5), atol=1e-6)
    np.testing.assert_allclose(normals[4], [0, 0, 1])


def test_laplacian_is_the_five_point_one_along_the_edges_of_faces():
    quadratic = (X**2 + 3 * Y**2)[:, None]
    inside = (np.minimum(X, Y) > 0) & (np.maximum(X, Y) < SIDE - 1)
    # Minus a quarter of the second differences.
    np.testing.assert_allclose(MESH.laplacian(quadratic)[inside], -2, atol=1e-3)
    np.testing.assert_allclose(MESH.laplacian(np.ones((SIDE**2, 1))), 0)
    # Two squares of pixels side by side, without a face between them: not neighbours.
    number = np.arange(8, dtype=np.int32).reshape(2, 4)
    faces = [[number[0, c], number[1, c], number[0, c + 1]] for c in (0, 2)] + [
        [number[0, c + 1], number[1, c], number[1, c + 1]] for c in (0, 2)
    ]
    apart = GridMesh(np.ones((2, 4), np.bool_), np.array(faces, np.int32))
    steps = np.array([[0, 0, 5, 5], [0, 0, 5, 5]], np.float32).reshape(-1, 1)
    np.testing.assert_array_equal(apart.laplacian(steps), 0)


def test_displacement_onto_a_plane_is_exact():
    """A plane is its own base, so that the heights above the source's base are unchanged."""
    height = WAVES - MESH.base(surface(WAVES), 5)[:, 2]
    for slope in (0.0, 0.7):
        plane = surface(slope * X)
        normal = np.array([-slope, 0, 1]) / np.hypot(slope, 1)
        # The source's base is only nearly flat, so its normals deviate slightly from z.
        moved = transferred(Displacement, surface(WAVES), plane)
        expected = plane + height[:, None] * normal
        np.testing.assert_allclose(moved[INNER], expected[INNER], atol=2e-3)


def test_a_constant_displacement_of_a_plane_is_not_detail():
    moved = transferred(Displacement, surface(np.full_like(X, 5)), surface(WAVES))
    np.testing.assert_allclose(moved, transferred(Displacement, FLAT, surface(WAVES)), atol=1e-5)


@pytest.mark.parametrize("transfer", PEERS)
def test_translations_of_the_source_do_nothing_and_of_the_target_move_the_result(transfer):
    by = np.array([3, -2, 5], np.float32)
    plain = transferred(transfer, surface(WAVES), BENT)
    np.testing.assert_allclose(transferred(transfer, surface(WAVES) + by, BENT), plain, atol=2e-3)
    moved = transferred(transfer, surface(WAVES), BENT + by)
    np.testing.assert_allclose(moved, plain + by, atol=2e-3)


@pytest.mark.parametrize("transfer", PEERS)
def test_a_rotation_of_both_surfaces_rotates_the_result(transfer):
    turn = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix().astype(np.float32).T
    plain = transferred(transfer, surface(WAVES), BENT)
    both = transferred(transfer, surface(WAVES) @ turn, BENT @ turn)
    np.testing.assert_allclose(both, plain @ turn, atol=5e-3)


@pytest.mark.parametrize("transfer", PEERS)
def test_no_detail_leaves_the_base_of_the_target(transfer):
    moved = transferred(transfer, FLAT, surface(WAVES) + BENT - FLAT)
    base = MESH.base(surface(WAVES) + BENT - FLAT, 5)
    # The source's border is pulled inwards, and Laplacian editing spreads this a little.
    np.testing.assert_allclose(moved[INNER], base[INNER], atol=0.02)


@pytest.mark.parametrize("transfer", PEERS)
def test_a_detail_transferred_to_a_plane_is_unchanged(transfer):
    moved = transferred(transfer, surface(WAVES), FLAT)
    error = (moved[:, 2] - WAVES)[INNER]
    assert np.sqrt(np.mean(error**2)) < 0.15 * WAVES.std()
    np.testing.assert_allclose(moved[INNER, :2], FLAT[INNER, :2], atol=0.05)


@pytest.mark.parametrize("transfer", PEERS)
def test_a_detail_rotates_with_its_target_surface(transfer):
    plane = surface(np.tan(np.radians(40)) * X)
    moved = transferred(transfer, surface(WAVES), plane)
    along = np.array([-np.sin(np.radians(40)), 0, np.cos(np.radians(40))])
    heights = (moved - plane) @ along
    across = np.linalg.norm(moved - plane - heights[:, None] * along, axis=1)
    assert np.corrcoef(heights[INNER], WAVES[INNER])[0, 1] > 0.99
    assert across[INNER].max() < 0.05


@pytest.mark.parametrize("transfer", PEERS)
def test_a_region_receives_and_the_rest_stays(transfer):
    target = surface(0.01 * (X - 30) ** 2)
    away = np.hypot(X - 30, Y - 30)
    region = away < 18
    moved = transferred(transfer, surface(WAVES), target, region=region)
    np.testing.assert_array_equal(moved[~region], target[~region])
    deep = away < 8
    # The waves cut off at the rim bend the surface inside slightly; its detail stays.
    detail = moved - MESH.base(moved, 5)
    assert np.corrcoef(detail[deep, 2], WAVES[deep])[0, 1] > 0.98


def test_laplacian_editing_solves_its_normal_equations():
    """The independently computed gradient of the least-squares problem is 0 at the result."""
    moved = transferred(DIRECT, surface(WAVES), FLAT).astype(np.float64)
    base, detail = MESH.base(FLAT, 5), surface(WAVES) - MESH.base(surface(WAVES), 5)
    # The bases of both surfaces are flat, so nothing is rotated.
    turned = MESH.laplacian(detail)
    step = moved - base
    gradient = MESH.laplacian(MESH.laplacian(step) - turned) + 0.02**2 * step
    assert np.abs(gradient[INNER]).max() < 1e-3 * np.abs(turned).max()


def test_multigrid_and_the_direct_solver_agree_on_a_real_mesh():
    ground = integrate(bowl(3000))
    made = height_mesh(ground)
    mesh = GridMesh(ground.mask, made.faces)
    x, y = made.vertices[:, 0], made.vertices[:, 1]
    source = made.vertices.copy()
    source[:, 2] = 0.6 * np.sin(x) * np.cos(y)
    task = MeshTask(made.vertices, mesh)
    results = [make(task).put(source) for make in (LaplacianEditing, DIRECT)]
    np.testing.assert_allclose(*results, atol=1e-3)
    a, b = (mesh.normals(vertices) for vertices in results)
    assert np.degrees(np.linalg.norm(a - b, axis=1)).max() < 0.01


def dense(inside: np.ndarray, anchor: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return right, down and the matrix of `Bilaplacian`, computed by a loop over pixels."""
    right, down = np.zeros((2, *inside.shape), np.float32)
    number = np.cumsum(inside).reshape(inside.shape) - 1
    laplacian = np.zeros((inside.sum(), inside.sum()))
    for r, c in zip(*np.nonzero(inside), strict=True):
        for weights, q, d in ((right, r, c + 1), (down, r + 1, c)):
            if inside[q, d]:
                weights[r, c] = 0.25
                i, j = number[r, c], number[q, d]
                laplacian[[i, j], [i, j]] += 0.25
                laplacian[[i, j], [j, i]] -= 0.25
    return right, down, laplacian @ laplacian + anchor**2 * np.eye(len(laplacian))


@settings(max_examples=25)
@given(
    rows=st.integers(1, 30),
    columns=st.integers(1, 30),
    share=st.floats(0.3, 1),
    anchor=st.sampled_from([0.005, 0.02, 0.5]),
    seed=st.integers(0, 1000),
)
def test_multigrid_solves_on_any_mask(rows, columns, share, anchor, seed):
    rng = np.random.default_rng(seed)
    inside = np.pad(rng.random((rows, columns)) < share, 1)
    right, down, matrix = dense(inside, anchor)
    b, start = np.zeros((2, *inside.shape))
    b[inside], start[inside] = rng.normal(size=(2, inside.sum()))
    found = Bilaplacian(right, down, inside, anchor).solve(b, start, 1e-9)
    np.testing.assert_array_equal(found[~inside], 0)
    np.testing.assert_allclose(matrix @ found[inside], b[inside], atol=1e-7)


def test_multigrid_says_when_it_does_not_converge(monkeypatch):
    monkeypatch.setattr(bilaplacian, "_MAX_ITERATIONS", 1)
    inside = np.pad(np.ones((30, 30), np.bool_), 1)
    right, down, _ = dense(inside, 0.01)
    b = np.where(inside, np.arange(inside.size).reshape(inside.shape) % 7, 0.0)
    with pytest.raises(ArithmeticError, match="1 iterations"):
        Bilaplacian(right, down, inside, 0.01).solve(b, np.zeros_like(b), 1e-9)


def test_multigrid_needs_few_steps_on_a_large_grid(monkeypatch):
    """The bound on the eigenvalues does not depend on the size of the grid."""
    monkeypatch.setattr(bilaplacian, "_MAX_ITERATIONS", 12)
    inside = np.pad(np.ones((300, 300), np.bool_), 1)
    right, down = np.zeros((2, *inside.shape), np.float32)
    right[1:-1, 1:-2] = down[1:-2, 1:-1] = 0.25
    b = np.where(inside, np.random.default_rng(0).normal(size=inside.shape), 0.0)
    Bilaplacian(right, down, inside, 0.02).solve(b, np.zeros_like(b), 1e-4)
