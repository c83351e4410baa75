"""Candidates that are shown to a person if no sphere is found."""

from dataclasses import replace

import numpy as np
import pytest

from calibration import EstimateError, calibrate_spheres
from calibration.spheres import sphere_candidates
from simulator import ChromeSphere, render, scene_named
from simulator.scene import Ball
from simulator.shapes import Checker, Even


@pytest.fixture(scope="module")
def scene():
    return replace(scene_named("spheres", width=320, height=256, leds=8), board=Even(0.4))


@pytest.mark.slow
def test_a_glossy_ball_is_a_candidate_and_not_a_sphere(scene):
    ball = Ball((-40.0, 20.0, 24.0), 24.0, 0.3, 0.1)
    rendering = render(replace(scene, spheres=(), clutter=(ball,)))
    values = (rendering.planes + rendering.ambient) * np.float32(5)
    with pytest.raises(EstimateError, match="no mirror sphere found"):
        calibrate_spheres(values)
    x, y = rendering.truth.camera.project(np.array([ball.centre_mm]))[0]
    near = [
        one
        for one in sphere_candidates(values)
        if np.hypot(one.circle_px[0] - x, one.circle_px[1] - y) < 0.5 * one.circle_px[2]
    ]
    assert near
    assert not near[0].mirrored >= 0.7
    assert "mirror" in near[0].reason() or "highlight" in near[0].reason()


def test_a_mirror_sphere_is_the_first_candidate(scene):
    sphere = ChromeSphere((-40.0, 20.0, 24.0), 24.0)
    rendering = render(replace(scene, spheres=(sphere,), board=Checker(0.2, 0.6, 20.0)))
    values = (rendering.planes + rendering.ambient) * np.float32(5)
    first = sphere_candidates(values, camera=rendering.truth.camera)[0]
    rows, columns = np.nonzero(rendering.truth.sphere_masks[0])
    assert first.circle_px[:2] == pytest.approx((columns.mean(), rows.mean()), abs=1)
    assert first.circle_px[2] == pytest.approx(np.sqrt(len(rows) / np.pi), rel=0.03)
    assert first.lights >= 4
    assert first.mirrored > 0.7
