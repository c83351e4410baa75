"""The lens: rays and projections, compared with OpenCV and closed forms."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import CameraModel, DataError
from simulator import Lens, bench_camera

WIDTH, HEIGHT, FAR = 640, 512, 600.0
K = np.array([[1307.0, 0, 322.3], [0, 1311.5, 250.9], [0, 0, 1]])
DISTORTIONS = [
    pytest.param([0, 0, 0, 0, 0], id="none"),
    pytest.param([-0.3, 0.15, 0, 0, 0], id="barrel"),
    pytest.param([0.4, -0.2, 0, 0, 0.1], id="pincushion"),
    pytest.param([-0.5, 2.5, 0, 0, 0], id="moustache"),
    pytest.param([-0.25, 0.1, 0.01, -0.012, -0.05], id="all-five"),
    pytest.param([0, 0, 0.02, 0.03, 0], id="tangential"),
    pytest.param([-1.4, 0, 0, 0, 0], id="nearly-folding"),
]


def _camera(distortion=(0.0,) * 5, skew=0.0, matrix=K, size=(WIDTH, HEIGHT)):
    K = matrix.copy()
    K[0, 1] = skew
    return CameraModel(K, *size, FAR, np.array(distortion, float))


def _pixels(beyond=0.5):
    return np.meshgrid(
        np.linspace(-beyond, WIDTH - 1 + beyond, 41), np.linspace(-beyond, HEIGHT - 1 + beyond, 33)
    )


def _opencv(camera, points):
    seen = (points.reshape(-1, 3) - [0, 0, FAR]) * [1, -1, -1]
    pixels, _ = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), camera.K, camera.distortion)
    return pixels.reshape(*points.shape[:-1], 2)


@pytest.mark.parametrize("distortion", DISTORTIONS)
def test_projection_equals_that_of_opencv(distortion):
    camera = _camera(distortion)
    points = np.random.default_rng(4).uniform([-140, -110, -50], [140, 110, 80], (500, 3))
    ours = Lens(camera).project(points)
    assert ours.min() < 20
    assert ours.max() > 600
    np.testing.assert_allclose(ours, _opencv(camera, points), atol=1e-9)


@pytest.mark.parametrize("distortion", DISTORTIONS)
def test_point_on_a_pixels_ray_projects_onto_the_pixel_by_opencv(distortion):
    camera = _camera(distortion)
    x, y = _pixels()
    origins, rays = Lens(camera).origins_and_rays(x, y)
    for depth in (350.0, 600.0, 800.0):
        back = _opencv(camera, origins + depth * rays)
        np.testing.assert_allclose(back, np.stack([x, y], -1), atol=1e-9)
    np.testing.assert_array_equal(rays[..., 2], -1)


@settings(max_examples=60)
@given(
    radial=st.tuples(st.floats(-0.6, 0.6), st.floats(-0.5, 0.5), st.floats(-0.3, 0.3)),
    tangential=st.tuples(st.floats(-0.02, 0.02), st.floats(-0.02, 0.02)),
    skew=st.floats(-20, 20),
)
def test_round_trip(radial, tangential, skew):
    lens = Lens(_camera([radial[0], radial[1], *tangential, radial[2]], skew))
    x, y = _pixels()
    origins, rays = lens.origins_and_rays(x, y)
    np.testing.assert_allclose(lens.project(origins + 500 * rays), np.stack([x, y], -1), atol=1e-9)


def test_skew_shears_the_columns():
    straight, sheared = Lens(_camera()), Lens(_camera(skew=13.0))
    point = np.array([30.0, -40.0, 100.0])
    down = 40.0 / (FAR - 100.0)
    np.testing.assert_allclose(
        sheared.project(point), straight.project(point) + np.array([13.0 * down, 0]), atol=1e-9
    )


def test_pinhole_with_simple_numbers():
    """A point 10 mm right and 20 mm up at 500 mm; up is toward the first row."""
    x, y = Lens(_camera()).project(np.array([10.0, 20.0, 100.0]))
    assert x == pytest.approx(322.3 + 1307 * 0.02)
    assert y == pytest.approx(250.9 - 1311.5 * 0.04)


@pytest.mark.parametrize(
    "distortion",
    [
        # The fold of k1 alone is at r^2 = 1 / (3 |k1|), its image at 2/3 of that radius; the
        # corners of this image are at 0.317.
        pytest.param([-1.7, 0, 0, 0, 0], id="fold-inside-the-corners"),
        pytest.param([-8.0, 0, 0, 0, 0], id="fold-in-mid-image"),
        pytest.param([0, 0, 0, 3.0, 0], id="tangential-fold"),
        pytest.param([-4.0, 6.0, 0, 0, 0], id="fold-and-back"),
    ],
)
def test_distortion_that_folds_over_is_refused(distortion):
    with pytest.raises(DataError, match="folds the image over itself"):
        Lens(_camera(distortion, matrix=np.array([[1300, 0, 319.5], [0, 1300, 255.5], [0, 0, 1]])))


def test_k1_is_refused_exactly_from_the_fold():
    corner = np.hypot(320.0, 256.0) / 1300.0
    limit = (2 / 3 / corner) ** 2 / 3
    matrix = np.array([[1300, 0, 319.5], [0, 1300, 255.5], [0, 0, 1]])
    Lens(_camera([-0.999 * limit], matrix=matrix))
    with pytest.raises(DataError, match="folds"):
        Lens(_camera([-1.001 * limit], matrix=matrix))


def test_orthographic_lens_with_simple_numbers():
    lens = Lens.orthographic(101, 51, 0.25, 300.0)
    origins, rays = lens.origins_and_rays([50, 0, 100], [25, 0, 50])
    np.testing.assert_allclose(origins, [[0, 0, 300], [-12.5, 6.25, 300], [12.5, -6.25, 300]])
    np.testing.assert_array_equal(rays, [[0, 0, -1]] * 3)
    np.testing.assert_allclose(lens.project(np.array([12.5, -6.25, -7.0])), [100, 50])
    assert lens.size == (51, 101)
    assert lens.camera_z_mm == 300.0
    np.testing.assert_array_equal(lens.eye_to(np.zeros((2, 3))), [[0, 0, 1]] * 2)
    np.testing.assert_array_equal(Lens.orthographic(9, 9, 1, 9, vignetting=1).vignette(0, 0), 1.0)


def test_orthographic_round_trip():
    lens = Lens.orthographic(WIDTH, HEIGHT, 0.37, 300.0)
    x, y = _pixels()
    origins, rays = lens.origins_and_rays(x, y)
    np.testing.assert_allclose(lens.project(origins + 90 * rays), np.stack([x, y], -1), atol=1e-9)


def test_orthographic_is_the_limit_of_a_far_camera():
    far = 1e7
    lens = Lens(
        CameraModel(np.array([[4 * far, 0, 50], [0, 4 * far, 25], [0, 0, 1]]), 101, 51, far)
    )
    points = np.random.default_rng(1).uniform(-10, 10, (50, 3))
    near = Lens.orthographic(101, 51, 0.25, 300.0)
    np.testing.assert_allclose(lens.project(points), near.project(points), atol=1e-4)
    np.testing.assert_allclose(lens.eye_to(points), near.eye_to(points), atol=2e-6)


def test_eye_to_is_opposite_to_the_ray():
    lens = Lens(_camera([-0.2, 0.1, 0.001, 0.002, 0]))
    x, y = _pixels()
    origins, rays = lens.origins_and_rays(x, y)
    expected = -rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    np.testing.assert_allclose(lens.eye_to(origins + 444 * rays), expected, atol=1e-12)


@pytest.mark.parametrize("amount", [0.0, 0.4, 1.0])
def test_vignetting_follows_the_field_angle(amount):
    lens = Lens(_camera([-0.3, 0.1, 0, 0, 0]), vignetting=amount)
    assert lens.vignette(322.3, 250.9) == pytest.approx(1.0, abs=1e-12)
    # A point 30 degrees off the axis would be outside this image; 12 degrees is inside.
    angle = np.radians(12)
    point = np.array([np.sin(angle) * 0.6, np.sin(angle) * 0.8, -np.cos(angle)]) * 500 + [0, 0, FAR]
    x, y = lens.project(point)
    assert lens.vignette(x, y) == pytest.approx(1 - amount * (1 - np.cos(angle) ** 4), rel=1e-12)


@pytest.mark.parametrize(
    ("cfa", "first"),
    [("RGGB", [[0, 1], [1, 2]]), ("GRBG", [[1, 0], [2, 1]]), ("BGGR", [[2, 1], [1, 0]])],
)
def test_colour_filters(cfa, first):
    y, x = np.mgrid[:4, :6]
    channel = Lens(_camera(), cfa=cfa).channel(x, y)
    np.testing.assert_array_equal(channel, np.tile(first, (2, 3)))
    np.testing.assert_array_equal(
        Lens(_camera(), cfa=cfa).channel(x[1:, 1:], y[1:, 1:]), channel[1:, 1:]
    )
    assert Lens(_camera()).channel(x, y) is None


LENSES = [
    pytest.param(Lens(bench_camera(WIDTH, HEIGHT)), id="pinhole"),
    pytest.param(Lens(_camera([-1.2, 0, 0.01, 0.02, 0])), id="barrel"),
    pytest.param(Lens(_camera([0.9, 0, 0.01, 0.02, 0])), id="pincushion"),
    pytest.param(Lens.orthographic(WIDTH, HEIGHT, 0.46, 400.0), id="orthographic"),
]


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize(
    ("centre", "radius"),
    [((-60.0, 50.0, 20.0), 20.0), ((10.0, -5.0, 90.0), 90.0), ((120.0, -95.0, 30.0), 30.0)],
)
def test_window_contains_every_pixel_whose_ray_hits_the_ball(lens, centre, radius):
    y, x = np.mgrid[: lens.size[0], : lens.size[1]]
    origins, rays = lens.origins_and_rays(x, y)
    miss = np.linalg.norm(np.cross(rays, origins - centre), axis=-1) / np.linalg.norm(rays, axis=-1)
    rows, columns = (np.flatnonzero((miss < radius).any(axis=a)) for a in (1, 0))
    window = lens.window(centre, radius)
    for result, span, most in zip((rows, columns), window, lens.size, strict=True):
        assert max(result[0] - 3, 0) <= span.start <= result[0]
        assert result[-1] + 1 <= span.stop <= min(result[-1] + 4, most)


@pytest.mark.parametrize("lens", LENSES)
def test_window_of_a_ball_outside_the_image_is_empty(lens):
    rows, columns = lens.window((400.0, 0.0, 20.0), 20.0)
    assert rows.stop <= rows.start or columns.stop <= columns.start
