"""The whole search with a lens that is out of focus: outlines, and their stated errors."""

import cv2
import numpy as np
import pytest

from calibration import find_spheres
from calibration.spheres import fit_circle, fit_ellipse
from calibration.spheres.outline.outline_noise import outline_covariance
from simulator import render, scene_named

BLUR_PX = 3.0


def out_of_focus(planes, noise):
    images = np.array([cv2.GaussianBlur(plane, (0, 0), BLUR_PX) for plane in planes])
    noisy = images + np.random.default_rng(0).normal(size=images.shape) * noise
    return noisy.astype(np.float32)


def outline_of(camera, sphere):
    """Return the ellipse at which the rays of a camera touch a sphere."""
    axis = np.array(sphere.centre_mm) - camera.centre_mm
    distance = np.linalg.norm(axis)
    axis = axis / distance
    first = np.cross(axis, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    angle = np.arange(180) * (2 * np.pi / 180)
    around = np.outer(np.cos(angle), first) + np.outer(np.sin(angle), np.cross(axis, first))
    sine = sphere.radius_mm / distance
    touch = distance * (1 - sine**2) * axis + sphere.radius_mm * np.sqrt(1 - sine**2) * around
    points = camera.project(camera.centre_mm + touch)
    return fit_ellipse(points, fit_circle(points)[0])[0]


@pytest.mark.slow
def test_spheres_on_a_board_are_found_with_errors_as_stated():
    scene = scene_named("spheres", width=1280, height=1024, leds=6)
    rendering = render(scene)
    camera = rendering.truth.camera
    values = out_of_focus(rendering.planes / np.median(rendering.planes) * 0.2, 0.001)
    found = find_spheres(values, camera=camera)
    assert len(found) == len(scene.spheres)
    true = sorted((outline_of(camera, one) for one in scene.spheres), key=lambda o: o.centre_px)
    chi_squares = []
    for sphere, outline in zip(found, true, strict=True):
        change = outline.change_to(sphere.outline)
        assert np.abs(change).max() < 0.15
        chi_squares.append(change @ np.linalg.solve(outline_covariance(sphere), change))
    # The 99.9 % quantile of chi-square with 3 degrees of freedom.
    assert max(chi_squares) < 16.3
