"""Spheres that the frame cuts off are used as far as they are visible."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calibration import EstimateError, calibrate_spheres
from simulator import ChromeSphere, render, scene_named
from tests.calibration.conftest import outline_in

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=[0.8, 0.6])
def scene(request):
    """Return images of a sphere of which this share of the width is visible, and of another one."""
    scene = scene_named("spheres", width=640, height=512, leds=12, seed=31)
    x = 0.97 * (-147 + 40 * request.param - 20)
    spheres = (ChromeSphere((x, 10.0, 20.0), 20.0), ChromeSphere((40.0, 30.0, 20.0), 20.0))
    rendering = render(replace(scene, spheres=spheres))
    values = rendering.planes + rendering.ambient
    values[values > 1] = np.nan
    masks = list(rendering.truth.sphere_masks)
    outlines = [outline_in(rendering.truth.camera, sphere) for sphere in spheres]
    return SimpleNamespace(
        values=values, masks=masks, outlines=outlines, camera=rendering.truth.camera
    )


def marks(scene, marked):
    circles = [(*one.centre_px, one.radius_px + 2) for one in scene.outlines]
    return {"searched": {}, "circles": {"circles": circles}, "masks": {"masks": scene.masks}}[
        marked
    ]


@pytest.mark.parametrize("marked", ["searched", "circles", "masks"])
def test_the_visible_part_gives_the_outline_and_its_coverage(scene, marked):
    calibration = calibrate_spheres(scene.values, camera=scene.camera, **marks(scene, marked))
    assert len(calibration.spheres) == 2
    cut, whole = calibration.spheres
    assert 0.4 < cut.coverage < 0.75
    assert whole.coverage > 0.9
    # The frame pulls the outline toward it by up to .4 px.
    assert cut.outline.circle_px == pytest.approx(scene.outlines[0].circle_px, abs=0.45)
    codes = {notice.code for notice in calibration.warnings}
    assert ("outline-partly-seen" in codes) == (cut.coverage < 0.6)


@pytest.mark.parametrize("marked", ["searched", "circles", "masks"])
def test_positions_do_not_turn_into_directions(scene, marked):
    """The highlights of some lights are beyond the frame: these lights are named."""
    with pytest.raises(EstimateError, match=r"lights? L02.* on fewer than 2 of 2 spheres"):
        calibrate_spheres(scene.values, camera=scene.camera, radius_mm=20.0, **marks(scene, marked))


@pytest.mark.parametrize("share", [0.5, 0.4])
def test_a_sphere_that_is_mostly_beyond_the_frame_is_named(share):
    scene = scene_named("spheres", width=640, height=512, leds=12, seed=31)
    x = 0.97 * (-147 + 40 * share - 20)
    spheres = (ChromeSphere((x, 10.0, 20.0), 20.0), ChromeSphere((40.0, 30.0, 20.0), 20.0))
    rendering = render(replace(scene, spheres=spheres))
    values = rendering.planes + rendering.ambient
    values[values > 1] = np.nan
    calibration = calibrate_spheres(values, camera=rendering.truth.camera)
    assert len(calibration.spheres) == 1
    (cut,) = [notice for notice in calibration.warnings if notice.code == "sphere-cut"]
    assert "233) px is not used" in cut.text
