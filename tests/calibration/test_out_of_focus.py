"""Balls that are out of focus, also so far that no single image shows their outline."""

import cv2
import numpy as np
import pytest

from acquisition import angle_deg
from calibration import calibrate_spheres, find_spheres
from calibration.spheres.outline.outline_noise import outline_covariance
from simulator import render, scene_named
from tests.calibration.conftest import outline_in

BLUR_PX = 3.0


def out_of_focus(planes, noise):
    images = np.array([cv2.GaussianBlur(plane, (0, 0), BLUR_PX) for plane in planes])
    noisy = images + np.random.default_rng(0).normal(size=images.shape) * noise
    return noisy.astype(np.float32)


@pytest.mark.slow
def test_spheres_on_a_board_are_found_with_errors_as_stated():
    scene = scene_named("spheres", width=1280, height=1024, leds=6)
    rendering = render(scene)
    camera = rendering.truth.camera
    values = out_of_focus(rendering.planes / np.median(rendering.planes) * 0.2, 0.001)
    found = find_spheres(values, camera=camera)
    assert len(found) == len(scene.spheres)
    true = sorted((outline_in(camera, one) for one in scene.spheres), key=lambda o: o.centre_px)
    chi_squares = []
    for sphere, outline in zip(found, true, strict=True):
        change = outline.change_to(sphere.outline)
        assert np.abs(change).max() < 0.15
        chi_squares.append(change @ np.linalg.solve(outline_covariance(sphere), change))
    # The 99.9 % quantile of chi-square with 3 degrees of freedom.
    assert max(chi_squares) < 16.3


CENTRE, RADIUS_PX = (152.6, 161.3), 120.0


def soft_ball(blur_px: float) -> tuple[np.ndarray, np.ndarray]:
    """Draw a dark ball before a bright wall, and sharp highlights; return them and the lights."""
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:320, :310]
    off = np.stack([x - CENTRE[0], y - CENTRE[1]], -1) / RADIUS_PX
    ball = 0.05 + 0.03 * off[..., 0] + 0.02 * np.sin(y / 9)
    around = np.arange(8) * np.pi / 4
    places = 0.25 * np.stack([np.cos(around), np.sin(around)], 1)
    images = []
    for place in places:
        wall = 0.3 + 0.1 * rng.random() + 0.0004 * x
        scene = np.where(np.hypot(*np.moveaxis(off, -1, 0)) < 1, ball, wall)
        image = cv2.GaussianBlur(scene, (0, 0), blur_px)
        distance = RADIUS_PX * np.linalg.norm(off - place, axis=-1)
        image += 4 * np.exp(-(distance**2) / 18) + rng.normal(0, 0.004, scene.shape)
        images.append(np.where(image > 1, np.nan, image))
    normals = np.column_stack([places * [1, -1], np.sqrt(1 - np.sum(places**2, 1))])
    return np.array(images, np.float32), 2 * normals[:, 2:] * normals - [0, 0, 1]


@pytest.mark.parametrize("blur_px", [6.0, 7.0])
def test_a_ball_whose_outline_no_image_shows_is_found(blur_px):
    values, directions = soft_ball(blur_px)
    result = calibrate_spheres(values)
    assert result.lights.errors is not None
    variances = np.trace(result.lights.errors.covariances, axis1=1, axis2=2) / 2
    errors = angle_deg(result.lights.unit_directions, directions)
    assert errors.max() < 2
    assert np.sqrt(np.mean(errors**2)) < 3 * np.degrees(np.sqrt(variances.mean()))
