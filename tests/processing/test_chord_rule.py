"""Edges of the chord rule against its closed forms: steps on spheres and planes, weights c^4."""

import numpy as np
import pytest

from processing.surface.chord_rule import orthographic_edges, perspective_edges
from rig.arrays import Bool, Float32, Float64


def even(normal: Float64, size: tuple[int, int] = (3, 4)) -> Float32:
    return np.broadcast_to(normal / np.linalg.norm(normal), (*size, 3)).astype(np.float32)


def tilted(degrees: float, around: float = 0.3) -> Float64:
    angle = np.radians(degrees)
    side = np.array([np.cos(around), np.sin(around)]) * np.sin(angle)
    return np.array([*side, np.cos(angle)])


def rays_of(size: tuple[int, int], focal_px: float, centre: tuple[float, float]) -> Float64:
    rows, columns = np.indices(size, np.float64)
    x, y = (columns - centre[0]) / focal_px, -(rows - centre[1]) / focal_px
    return np.stack([x, y, -np.ones(size)], axis=2)


def seen_by_a_camera(normals: Float32, mask: Bool) -> tuple[Float32, Float32, Float64, Float64]:
    rows, columns = mask.shape
    middle = ((columns - 1) / 2, (rows - 1) / 2)
    return perspective_edges(normals, mask, rays_of((rows, columns), 1e7, middle))


EDGES = {"far": orthographic_edges, "camera": seen_by_a_camera}


@pytest.mark.parametrize("degrees", [0.0, 20.0, 45.0, 60.0, 80.0, 89.0])
def test_the_weight_of_an_edge_is_the_fourth_power_of_the_cosine(degrees: float) -> None:
    normals, mask = even(tilted(degrees)), np.ones((3, 4), bool)
    right, down, step_right, step_down = orthographic_edges(normals, mask)
    expected = np.cos(np.radians(degrees)) ** 4
    np.testing.assert_allclose(right[1:4, 1:4], expected, rtol=1e-4)
    np.testing.assert_allclose(down[1:3, 1:5], expected, rtol=1e-4)
    x, y, z = tilted(degrees)
    np.testing.assert_allclose(step_right[1:4, 1:4], -x / z, rtol=1e-4)
    np.testing.assert_allclose(step_down[1:3, 1:5], y / z, rtol=1e-4)
    # The border and the last column or row have no outgoing edge.
    for edges in (right, step_right):
        assert not edges[:, 4:].any()
    for edges in (down, step_down):
        assert not edges[3:].any()


@pytest.mark.parametrize("degrees", [0.0, 20.0, 45.0, 65.0])
def test_with_a_camera_the_weight_depends_on_the_line_of_sight(degrees: float) -> None:
    """The viewing angle of a pixel far off the axis differs from the tilt of the plane."""
    size = (3, 4)
    rays = rays_of(size, 1e4, (-3e3, 2e3))
    normals = even(tilted(degrees, around=0.2), size)
    right, down, step_right, step_down = perspective_edges(normals, np.ones(size, bool), rays)
    unit = rays / np.linalg.norm(rays, axis=2, keepdims=True)
    cosine = -(normals.astype(float) * unit).sum(axis=2)
    np.testing.assert_allclose(right[1:4, 1:4], cosine[:, :-1] ** 4, rtol=2e-3)
    np.testing.assert_allclose(down[1:3, 1:5], cosine[:-1] ** 4, rtol=2e-3)
    # On a plane n . d r is the same everywhere.
    depth = -1 / (normals.astype(float) * rays).sum(axis=2)
    np.testing.assert_allclose(step_right[1:4, 1:4], np.diff(np.log(depth), axis=1), rtol=1e-4)
    np.testing.assert_allclose(step_down[1:3, 1:5], np.diff(np.log(depth), axis=0), rtol=1e-4)


def test_the_weight_is_the_inverse_variance_of_the_step() -> None:
    """The scatter of a step for noisy normals agrees with the weight, for every tilt."""
    draw = np.random.default_rng(0)
    product = []
    for degrees in (0.0, 30.0, 60.0):
        normals = even(tilted(degrees), (200, 200)).astype(float)
        noise = 1e-3 * draw.normal(size=normals.shape)
        noise -= (noise * normals).sum(axis=2, keepdims=True) * normals
        noisy = (normals + noise).astype(np.float32)
        right, _, step, _ = orthographic_edges(noisy, np.ones((200, 200), bool))
        inside = slice(1, 201), slice(1, 200)
        along = np.cos(0.3) ** 2 + np.sin(0.3) ** 2 * np.cos(np.radians(degrees)) ** 2
        product.append(step[inside].var() / along * right[inside].mean())
    np.testing.assert_allclose(product, product[0], rtol=0.05)


def test_a_sphere_is_exact() -> None:
    radius, size = 40.0, (41, 41)
    rows, columns = np.indices(size, np.float64)
    x, y = columns - 20, -(rows - 20)
    z = np.sqrt(radius**2 - x**2 - y**2)
    normals = (np.stack([x, y, z], axis=2) / radius).astype(np.float32)
    _, _, right, down = orthographic_edges(normals, np.ones(size, bool))
    np.testing.assert_allclose(right[1:-1, 1:-2], np.diff(z, axis=1), atol=1e-5)
    np.testing.assert_allclose(down[1:-2, 1:-1], np.diff(z, axis=0), atol=1e-5)


@pytest.mark.parametrize(
    ("first", "second", "joined"),
    [
        pytest.param(tilted(89.3), tilted(89.3), True, id="just seen"),
        pytest.param(tilted(89.5), tilted(89.5), False, id="grazing"),
        pytest.param(tilted(100.0), tilted(100.0), False, id="from behind"),
        pytest.param(tilted(59.0), tilted(-59.0), True, id="118 degrees apart"),
        pytest.param(tilted(61.0), tilted(-61.0), False, id="122 degrees apart"),
    ],
)
@pytest.mark.parametrize("seen_from", EDGES)
def test_pixels_without_an_edge(
    first: Float64, second: Float64, joined: bool, seen_from: str
) -> None:
    normals = np.stack([first, second])[None].astype(np.float32)
    mask = np.ones((1, 2), bool)
    right, *_ = EDGES[seen_from](normals, mask)
    assert (right[1, 1] > 0) == joined


@pytest.mark.parametrize("seen_from", EDGES)
def test_edges_end_at_the_mask(seen_from: str) -> None:
    mask = np.array([[1, 1, 0], [0, 1, 1]], bool)
    normals = even(tilted(10.0), (2, 3))
    right, down, *steps = EDGES[seen_from](normals, mask)
    assert right.shape == down.shape == (4, 5)
    assert [step.shape for step in steps] == [(4, 5)] * 2
    assert (right.dtype, steps[0].dtype) == (np.float32, np.float64)
    assert {(int(r) - 1, int(c) - 1) for r, c in np.argwhere(right)} == {(0, 0), (1, 1)}
    assert {(int(r) - 1, int(c) - 1) for r, c in np.argwhere(down)} == {(0, 1)}
