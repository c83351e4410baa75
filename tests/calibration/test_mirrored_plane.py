"""Spheres on a checkerboard are found by what they mirror; painted balls are refused."""

from dataclasses import replace

import numpy as np
import pytest

from calibration import find_spheres
from calibration.spheres import find_highlights, fit_ellipse
from calibration.spheres.propose.edge_search import is_painted
from simulator import ChromeSphere, render, scene_named
from simulator.scene import Ball
from simulator.shapes import Checker


@pytest.fixture(scope="module")
def checkered():
    scene = scene_named("spheres", width=480, height=384, leds=12, seed=2)
    scene = replace(
        scene,
        board=Checker(0.08, 0.7, 15.0),
        spheres=(ChromeSphere((-60.0, 30.0, 20.0), 20.0), ChromeSphere((70.0, 35.0, 16.0), 16.0)),
        clutter=(Ball((0.0, -60.0, 20.0), 20.0, 0.3, 0.1),),
    )
    rendering = render(scene)
    values = (rendering.planes + rendering.ambient) * np.float32(5.0)
    return values, rendering.truth


@pytest.mark.slow
def test_outlines_on_a_checkerboard(checkered):
    values, truth = checkered
    spheres = find_spheres(values, camera=truth.camera)
    assert [sphere.covariance_px2 is not None for sphere in spheres] == [True, True]
    for sphere, mask in zip(spheres, truth.sphere_masks, strict=True):
        rows, columns = np.nonzero(mask)
        circle = columns.mean(), rows.mean(), np.sqrt(mask.sum() / np.pi)
        assert sphere.outline.circle_px == pytest.approx(circle, abs=0.3)


@pytest.mark.slow
def test_a_glossy_ball_is_shaded_and_a_mirror_is_not(checkered):
    values, truth = checkered
    angles = np.linspace(0, 2 * np.pi, 90)
    ring = 18 * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(90)])
    painted, _ = fit_ellipse(truth.camera.project(ring + np.array([0.0, -60.0, 20.0])))
    assert is_painted(values, painted, find_highlights(values, painted))
    (mirror, _) = find_spheres(values, camera=truth.camera)
    assert not is_painted(values, mirror.outline, mirror.highlights)
