"""CameraModel: its frame against OpenCV's, rays against projection, refusals."""

import cv2
import numpy as np
import pytest

from acquisition import CameraModel, DataError

K = np.array([[1000.0, 0, 320], [0, 1010, 240], [0, 0, 1]])


def _sheared(skew):
    sheared = K.copy()
    sheared[0, 1] = skew
    return sheared


def test_up_in_the_scene_is_up_in_the_image():
    camera = CameraModel(K, 640, 480, 600.0)
    x, y = camera.project([10.0, 20.0, 0.0])
    np.testing.assert_allclose([x, y], [320 + 1000 * 10 / 600, 240 - 1010 * 20 / 600])


@pytest.mark.parametrize("skew", [0.0, 50.0])
@pytest.mark.parametrize(
    "distortion",
    [
        pytest.param(np.zeros(5), id="pinhole"),
        pytest.param([-0.2, 0.1, 1e-3, -2e-3, 0.02], id="Brown"),
    ],
)
def test_rays_invert_projection(distortion, skew):
    camera = CameraModel(_sheared(skew), 640, 480, 600.0, distortion)
    points = np.random.default_rng(0).uniform(-80, 80, (200, 3))
    depth = 600.0 - points[:, 2:]
    back = camera.centre_mm + depth * camera.rays(camera.project(points))
    np.testing.assert_allclose(back, points, atol=1e-9)


@pytest.mark.parametrize("distortion", [np.zeros(5), [-0.2, 0.1, 0, 0, 0]], ids=["none", "Brown"])
def test_empty_arrays_give_no_pixels_and_no_rays(distortion):
    camera = CameraModel(K, 640, 480, 600.0, distortion)
    assert camera.project(np.zeros((0, 3))).shape == (0, 2)
    assert camera.rays(np.zeros((0, 2))).shape == (0, 3)


def test_points_on_plane_lie_on_it_and_project_back():
    camera = CameraModel(K, 64, 48, 600.0)
    points = camera.points_on_plane(5.0)
    assert points.shape == (48, 64, 3)
    np.testing.assert_allclose(points[..., 2], 5.0)
    np.testing.assert_allclose(camera.project(points)[7, 9], [9, 7], atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        pytest.param((np.eye(2), 4, 4), "3 x 3", id="shape"),
        pytest.param((K * np.nan, 4, 4), "finite", id="nan"),
        pytest.param((-K, 4, 4), "focal", id="negative"),
        pytest.param((K.T, 4, 4), "must have the form", id="transposed"),
        pytest.param((K, 0, 4), "no pixels", id="no width"),
        pytest.param((K, 4, 4, -1.0), "working distance", id="distance"),
        pytest.param((K, 4, 4, 1.0, np.ones(8)), "distortion", id="rational model"),
    ],
)
def test_camera_refuses(arguments, message):
    with pytest.raises(DataError, match=message):
        CameraModel(*arguments)


def test_a_missing_working_distance_is_reported_by_its_key():
    with pytest.raises(DataError, match="working_distance_mm"):
        CameraModel(K, 4, 4).points_on_plane()


def test_projection_without_skew_equals_opencv():
    distortion = np.array([-0.2, 0.1, 1e-3, -2e-3, 0.02])
    camera = CameraModel(K, 640, 480, 600.0, distortion)
    points = np.random.default_rng(1).uniform(-80, 80, (50, 3))
    seen = (points - [0, 0, 600]) * [1, -1, -1]
    expected, _ = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), K, distortion)
    np.testing.assert_allclose(camera.project(points), expected[:, 0], atol=1e-9)


def test_skew_shears_the_image():
    sheared = CameraModel(_sheared(50.0), 640, 480, 600.0)
    x, y = sheared.project([10.0, 20.0, 0.0])
    np.testing.assert_allclose(
        [x, y], [320 + 1000 * 10 / 600 - 50 * 20 / 600, 240 - 1010 * 20 / 600]
    )
