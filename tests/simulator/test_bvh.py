"""The searches of the tree, compared with brute force, and on shared edges."""

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.shapes.bvh import TriangleTree
from tests.cases import cases


def _random_triangles(count, seed, size=0.3):
    """Random triangles: some large, some tiny, some slivers."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-1, 1, (count, 1, 3))
    return middle + size * rng.normal(size=(count, 3, 3)) * rng.uniform(0.05, 1.5, (count, 1, 1))


def _rays(count, seed):
    """Rays from outside toward points between the triangles, where t is 1."""
    origins, aims = np.random.default_rng(seed).uniform(-1, 1, (2, count, 3)) * [[[2]], [[0.8]]]
    return origins, aims - origins


def _brute(corners, origins, directions):
    """Solve o + t d = a + u (b - a) + v (c - a) for every pair of ray and triangle."""
    a = corners[:, 0]
    u, v = corners[:, 1] - a, corners[:, 2] - a
    t = np.full((len(origins), len(corners)), np.inf)
    for i, (start, way) in enumerate(zip(origins, directions, strict=True)):
        matrix = np.stack([np.broadcast_to(-way, u.shape), u, v], axis=2)
        solved = np.linalg.solve(matrix, (start - a)[..., None])[..., 0]
        hit = (solved[:, 0] > 0) & (solved[:, 1] >= 0) & (solved[:, 2] >= 0)
        hit &= solved[:, 1] + solved[:, 2] <= 1
        t[i, hit] = solved[hit, 0]
    return t


@pytest.mark.parametrize("count", [1, 2, 3, 5, 17, 400])
def test_closest_equals_brute_force(count):
    corners, (origins, directions) = _random_triangles(count, seed=count), _rays(300, seed=1)
    t, weights, face = TriangleTree.grow(corners).closest(origins, directions)
    every = _brute(corners, origins, directions)
    np.testing.assert_allclose(t, every.min(axis=1), rtol=1e-9)
    hit = np.isfinite(t)
    np.testing.assert_array_equal(face, np.where(hit, every.argmin(axis=1), -1))
    met = (corners[face[hit]] * weights[hit, :, None]).sum(axis=1)
    np.testing.assert_allclose(met, origins[hit] + t[hit, None] * directions[hit], atol=1e-9)
    if count == 400:
        assert 150 < hit.sum() < 300


@pytest.mark.parametrize("reach", [0.3, 1.0, math.inf])
def test_blocked_equals_brute_force(reach):
    corners, (origins, directions) = _random_triangles(120, seed=8), _rays(500, seed=2)
    result = TriangleTree.grow(corners).blocked(origins, directions, reach)
    expected = _brute(corners, origins, directions).min(axis=1) < reach
    np.testing.assert_array_equal(result, expected)
    assert 25 < result.sum() < 475


@settings(max_examples=25)
@given(count=st.integers(1, 80), seed=st.integers(0, 10_000), axis=st.integers(0, 2))
def test_rays_along_an_axis(count, seed, axis):
    """Two components of the direction are 0: divisions by zero must be harmless."""
    corners, (origins, _) = _random_triangles(count, seed), _rays(40, seed)
    directions = np.zeros((40, 3))
    directions[:, axis] = np.where(np.arange(40) % 2, 1.0, -2.0)
    t, _, _ = TriangleTree.grow(corners).closest(origins, directions)
    np.testing.assert_allclose(t, _brute(corners, origins, directions).min(axis=1), rtol=1e-7)


def test_every_triangle_is_within_the_boxes_of_the_tree():
    corners = _random_triangles(700, seed=3)
    tree = TriangleTree.grow(corners)
    np.testing.assert_array_equal(np.sort(tree.faces), np.arange(700))
    np.testing.assert_array_equal(tree.corners, corners[tree.faces])
    seen = np.zeros(700, int)

    def check(node, low, high):
        assert np.all(tree.bounds[node, :3] >= low)
        assert np.all(tree.bounds[node, 3:] <= high)
        low, high = tree.bounds[node, :3], tree.bounds[node, 3:]
        if tree.count[node]:
            part = slice(tree.first[node], tree.first[node] + tree.count[node])
            seen[part] += 1
            assert np.all(tree.corners[part] >= low)
            assert np.all(tree.corners[part] <= high)
        else:
            check(node + 1, low, high)
            check(tree.first[node], low, high)

    check(0, np.full(3, -np.inf), np.full(3, np.inf))
    np.testing.assert_array_equal(seen, 1)


@cases(
    "corners",
    {
        "all-the-same": np.tile(_random_triangles(1, seed=1), (3000, 1, 1)),
        "each-smaller-than-last": _random_triangles(1, seed=1)
        * 1.5 ** -np.arange(600.0)[:, None, None],
    },
)
def test_degenerate_triangles_do_not_exceed_the_stack(corners):
    origins, directions = _rays(200, seed=4)
    directions = corners[0].mean(axis=0) - origins
    t, _, face = TriangleTree.grow(corners).closest(origins, directions)
    np.testing.assert_array_equal(face >= 0, np.isfinite(t))
    expected = _brute(corners[:40], origins, directions).min(axis=1)
    assert np.all(t <= expected * (1 + 1e-9))
    assert np.isfinite(t).all()


def test_no_ray_passes_through_a_closed_mesh():
    """Rays exactly at edges and vertices from inside, where gaps would be visible."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    corners = ball.triangles
    tree = TriangleTree.grow(np.asarray(corners))
    rng = np.random.default_rng(5)
    share = rng.uniform(0, 1, (8, len(corners), 1))
    a, b = corners[:, 0], corners[:, 1]
    aims = np.concatenate([*(a + share * (b - a)), np.asarray(ball.vertices)])
    for inside in ((0.0, 0.0, 0.0), (0.3, -0.2, 0.5), (0.1, 0.1, 0.1)):
        origins = np.tile(np.array(inside), (len(aims), 1))
        t, _, _ = tree.closest(origins, aims - origins)
        np.testing.assert_allclose(t, 1.0, rtol=1e-9)
        assert tree.blocked(origins, aims - origins, 1.001).all()


def test_no_ray_passes_through_a_grid_in_the_plane():
    """Camera rays exactly through the vertices of a triangulated height field."""
    n = 40
    y, x = np.mgrid[:n, :n].astype(float)
    points = np.stack([x, y, 0.3 * np.sin(x) * np.cos(1.3 * y)], axis=-1).reshape(-1, 3)
    first = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate(
        [
            np.stack([first, first + 1, first + n], axis=1),
            np.stack([first + 1, first + n + 1, first + n], axis=1),
        ]
    )
    tree = TriangleTree.grow(points[faces])
    inner = points[(points[:, :2] > 0).all(axis=1) & (points[:, :2] < n - 1).all(axis=1)]
    for eye in (np.array([20.0, 20.0, 60.0]), np.array([0.5, 3.25, 30.0])):
        t, _, face = tree.closest(np.tile(eye, (len(inner), 1)), inner - eye)
        assert (face >= 0).all()
        assert t.max() < 1 + 1e-9


def test_points_lifted_off_a_convex_mesh_do_not_block_themselves():
    ball = trimesh.creation.icosphere(subdivisions=3)
    tree = TriangleTree.grow(np.asarray(ball.triangles))
    outward = np.asarray(ball.face_normals)
    points = np.asarray(ball.triangles_center) + 1e-6 * outward
    lamp = np.array([3.0, 1.0, 2.0])
    facing = ((lamp - points) * outward).sum(axis=1) > 0
    np.testing.assert_array_equal(tree.blocked(points, lamp - points), ~facing)
