"""Albedo patterns: values at positions, and detection of the ChArUco corners by OpenCV."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.shapes import ChArUco, Checker, ColourWheel, Even, Gradient, Paint
from tests.quick_sample import quick

PATTERNS = [
    pytest.param(Even(0.3), 1, id="even"),
    pytest.param(Even((0.2, 0.3, 0.9)), 3, id="even-colour"),
    pytest.param(Checker(), 1, id="checker"),
    pytest.param(Checker(0.1, (0.9, 0.5, 0.1)), 3, id="checker-colour"),
    pytest.param(Gradient(angle_deg=30.0), 1, id="gradient"),
    pytest.param(Gradient((0.9, 0.1, 0.1), (0.1, 0.1, 0.9)), 3, id="gradient-colour"),
    pytest.param(Paint(0.2, 0.7), 1, id="paint"),
    pytest.param(ColourWheel(), 3, id="colour-wheel"),
    pytest.param(ChArUco(), 1, id="charuco"),
]


@pytest.mark.parametrize(("pattern", "channels"), PATTERNS)
def test_albedo_has_the_shape_of_the_positions_and_is_within_bounds(pattern, channels):
    x, y = np.random.default_rng(0).uniform(-150, 150, (2, 40, 50))
    albedo = pattern.evaluate(x, y)
    assert albedo.shape == ((40, 50) if channels == 1 else (40, 50, 3))
    assert albedo.dtype == np.float64
    assert albedo.min() >= 0
    assert albedo.max() <= 1
    single = pattern.evaluate(x[3, 4:5], y[3, 4:5])
    np.testing.assert_array_equal(single[0], albedo[3, 4])


def test_even_is_uniform():
    x = np.zeros((2, 3))
    np.testing.assert_array_equal(Even(0.3).evaluate(x, x), 0.3)
    np.testing.assert_array_equal(Even((0.1, 0.2, 0.3)).evaluate(x, x)[1, 2], [0.1, 0.2, 0.3])


def test_checker_alternates_from_the_origin():
    x, y = np.array([5.0, -5.0, -5.0, 5.0, 15.0, 5.0]), np.array([5.0, 5.0, -5.0, -5.0, 5.0, 25.0])
    albedo = Checker(0.2, 0.8, 10.0).evaluate(x, y)
    np.testing.assert_allclose(albedo, [0.8, 0.2, 0.8, 0.2, 0.2, 0.8])


@settings(max_examples=50)
@given(x=st.floats(-90, 90), y=st.floats(-90, 90), square=st.floats(0.5, 30))
def test_checker_repeats_every_second_square(x, y, square):
    checker = Checker(0.0, 1.0, square)
    # Away from edges, where rounding decides the side of a point.
    near = np.abs(np.array([x, y]) / square - np.round(np.array([x, y]) / square)).min()
    if near > 1e-9:
        at, there = np.array([[x], [y]]), np.array([[x + 2 * square], [y - 4 * square]])
        np.testing.assert_array_equal(checker.evaluate(*at), checker.evaluate(*there))
        neighbour = np.array([[x + square], [y]])
        np.testing.assert_array_equal(checker.evaluate(*at), 1 - checker.evaluate(*neighbour))


@pytest.mark.parametrize(
    ("angle", "step"),
    [(0.0, (1.0, 0.0)), (90.0, (0.0, 1.0)), (180.0, (-1.0, 0.0)), (45.0, (0.5**0.5, 0.5**0.5))],
)
def test_gradient_changes_along_its_angle(angle, step):
    along = np.array([-500.0, -50.0, 0.0, 25.0, 50.0, 500.0])
    gradient = Gradient(0.1, 0.9, length_mm=100.0, angle_deg=angle)
    albedo = gradient.evaluate(along * step[0], along * step[1])
    np.testing.assert_allclose(albedo, [0.1, 0.1, 0.5, 0.7, 0.9, 0.9], atol=1e-12)
    across = gradient.evaluate(-along * step[1], along * step[0])
    np.testing.assert_allclose(across, 0.5, atol=1e-12)


def test_coloured_gradient_blends_each_channel():
    albedo = Gradient((1.0, 0.0, 0.5), (0.0, 1.0, 0.5)).evaluate(np.zeros(1), np.zeros(1))
    np.testing.assert_allclose(albedo, [[0.5, 0.5, 0.5]])


def test_colour_wheel_turns_from_red_to_green_to_blue():
    angle = np.radians([0.0, 120.0, 240.0])
    wheel = ColourWheel(50.0, 0.1, 0.9)
    x, y = np.cos(angle), np.sin(angle)
    full = wheel.evaluate(50 * x, 50 * y)
    np.testing.assert_array_equal(full.argmax(axis=1), [0, 1, 2])
    np.testing.assert_allclose(full.max(axis=1), 0.9)
    np.testing.assert_allclose(full.min(axis=1), 0.3)
    np.testing.assert_allclose(wheel.evaluate(90 * x, 90 * y), full)
    np.testing.assert_allclose(wheel.evaluate(np.zeros(1), np.zeros(1)), 0.5)


def test_charuco_has_its_squares_and_paper():
    board = ChArUco(5, 4, 10.0, black=0.1, white=0.9)
    # The centres of black squares; the first one, at the upper left, is black.
    x, y = np.meshgrid(10.0 * (np.arange(5) - 2), 10.0 * (1.5 - np.arange(4)))
    black = np.add.outer(np.arange(4), np.arange(5)) % 2 == 0
    np.testing.assert_array_equal(board.evaluate(x[black], y[black]), 0.1)
    # White squares show paper at their edges and ink on the frame of the marker.
    np.testing.assert_array_equal(board.evaluate(x[~black] - 4.4, y[~black]), 0.9)
    np.testing.assert_array_equal(board.evaluate(x[~black] - 3.1, y[~black]), 0.1)
    beyond = np.array([25.1, -25.1, 0.0, 0.0]), np.array([0.0, 0.0, 20.1, -20.1])
    np.testing.assert_array_equal(board.evaluate(*beyond), 0.9)


@pytest.mark.parametrize(("columns", "rows"), quick([(7, 5), (6, 8)], every=2))
def test_opencv_detects_the_charuco_corners_at_their_positions(columns, rows):
    board = ChArUco(columns, rows, 20.0)
    pixel_mm, fine = 0.25, 16
    width, height = (int((count * 20 + 15) / pixel_mm) for count in (columns, rows))
    middle = np.array([(width - 1) / 2 - 0.31, (height - 1) / 2 + 0.17])
    # An orthographic image: the mean over each pixel, then the blur of a lens.
    u, v = ((np.arange(count * fine) + 0.5) / fine - 0.5 for count in (width, height))
    picture = np.zeros((height, width))
    for row in range(height):
        x, y = np.meshgrid(u - middle[0], middle[1] - v[row * fine : (row + 1) * fine])
        part = board.evaluate(x * pixel_mm, y * pixel_mm)
        picture[row] = part.reshape(fine, width, fine).mean(axis=(0, 2))
    picture = np.round(255 * cv2.GaussianBlur(picture, (0, 0), 1.0)).astype(np.uint8)
    grid = cv2.aruco.CharucoBoard(
        (columns, rows), 4.0, 3.0, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250)
    )
    corners, ids, _, _ = cv2.aruco.CharucoDetector(grid).detectBoard(picture)
    assert ids is not None
    np.testing.assert_array_equal(np.sort(ids.ravel()), np.arange((columns - 1) * (rows - 1)))
    expected = board.corners_mm[ids.ravel()] / pixel_mm * [1, -1] + middle
    assert np.abs(corners.reshape(-1, 2) - expected).max() < 0.1
