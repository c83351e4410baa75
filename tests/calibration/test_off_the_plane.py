"""Spheres on pedestals, or with another radius than given, are named."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from acquisition import CameraModel
from calibration import calibrate_spheres
from calibration.spheres import Ellipse, KnownSpheres
from calibration.spheres.solve.sphere_positions import one_off_the_plane
from simulator import ChromeSphere, render, scene_named

CAMERA = CameraModel(np.array([[2000.0, 0, 320], [0, 2000.0, 256], [0, 0, 1]]), 640, 512, 600.0)


def noticed(heights, sigma):
    """Return the notices about spheres of these heights above the plane, k-th at x = 100 k px."""
    radii = np.full(len(heights), 10.0)
    centres = np.column_stack([radii, radii, radii + heights])
    known = KnownSpheres(centres, radii, np.eye(3 * len(heights)) * sigma**2)
    images = [
        SimpleNamespace(outline=Ellipse((100.0 * k, 50.0), (30.0, 30.0)))
        for k in range(len(heights))
    ]
    return one_off_the_plane(known, CAMERA, images)


@pytest.mark.parametrize(
    ("heights", "sigma", "named"),
    [
        pytest.param([12.0], 0.5, None, id="one sphere has no others"),
        pytest.param([0.4, -0.7, 0.2, 0.5], 0.5, None, id="all rest on the plane"),
        pytest.param([12.0, 12.0, 12.5], 0.5, None, id="all on pedestals: another test"),
        pytest.param([0.0, 12.0], 0.5, "(100, 50) px 12 +- 1 mm above", id="the upper of two"),
        pytest.param([12.0, 0.0], 0.5, "(0, 50) px 12 +- 1 mm above", id="whatever their order"),
        pytest.param([0.0, 0.0, 12.0], 0.5, "(200, 50) px 12 +- 1 mm above", id="one of three"),
        pytest.param([0.0, -9.0, 1.0, 0.0], 0.5, "(100, 50) px 9 +- 1 mm below", id="a hollow"),
        pytest.param([0.0, 5.9], 0.1, None, id="less than 1 % of the distance"),
        pytest.param([0.0, 6.1], 0.1, "above", id="just more"),
        pytest.param([0.0, 12.0], 3.0, None, id="not known well enough"),
    ],
)
def test_the_sphere_off_the_plane_is_named(heights, sigma, named):
    notices = noticed(heights, sigma)
    assert len(notices) == (named is not None)
    for notice in notices:
        assert notice.code == "sphere-off-the-plane"
        assert named in notice.text


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lifts", "code"),
    [
        pytest.param((0.0, 0.0), None, id="on the plane"),
        pytest.param((5.0, 0.0), "sphere-off-the-plane", id="one on a pedestal"),
        pytest.param((5.0, 5.0), "lights-uncertain", id="both on pedestals"),
        pytest.param((20.0, 20.0), "ratio-contradicted", id="both one radius high"),
    ],
)
def test_pedestals_do_not_pass_silently(lifts, code):
    """A notice names what is wrong; low pedestals are harmless, because the edges show the ball."""
    scene = scene_named("spheres", width=640, height=536, leds=8, seed=31)
    places = [(-85.0, -65.0), (85.0, 65.0)]
    spheres = tuple(
        ChromeSphere((*at, 20.0 + up), 20.0) for at, up in zip(places, lifts, strict=True)
    )
    rendering = render(replace(scene, spheres=spheres))
    values = rendering.planes + rendering.ambient
    found = calibrate_spheres(values, camera=rendering.truth.camera, radius_mm=20.0)
    of_plane = {"sphere-off-the-plane", "ratio-contradicted", "spheres-off-the-plane"}
    codes = {notice.code for notice in found.warnings}
    assert code in codes if code else not codes
    off_mm = np.linalg.norm(found.lights.positions_mm - rendering.truth.lights.positions_mm, axis=1)
    assert off_mm.mean() < 2 or codes & of_plane
