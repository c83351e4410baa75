"""Size of a pixel from spheres of known radius, without a working distance."""

from dataclasses import replace

import numpy as np
import pytest

from calibration import EstimateError, calibrate_spheres
from simulator import render, scene_named
from tests.cases import cases

SCENE = scene_named("spheres", width=400, height=320, leds=6)
RENDERED = render(SCENE)
MASKS = list(RENDERED.truth.sphere_masks)
CAMERA = RENDERED.truth.camera
RADII = [sphere.radius_mm for sphere in SCENE.spheres]


def calibrated(radius_mm, masks=MASKS, **options):
    return calibrate_spheres(RENDERED.planes, masks=masks, radius_mm=radius_mm, **options)


@cases("count", {"one sphere": 1, "all spheres": len(MASKS)})
def test_a_pixel_is_as_large_as_at_the_centres(count):
    found = calibrated(RADII[:count], MASKS[:count])
    away = CAMERA.centre_mm[2] - np.mean(RADII[:count])
    expected = away / CAMERA.focal_px
    assert found.pixel_mm == pytest.approx(expected, rel=0.01)
    assert 0 < found.pixel_sigma_mm < 0.02 * expected
    assert [n.code for n in found.warnings if "scale" in n.code] == ["scale-from-spheres"]
    assert not found.lights.near


@cases("count", {"one sphere": 1, "all spheres": len(MASKS)})
def test_a_camera_without_a_distance_sees_in_perspective(count):
    """Its directions are those without a radius, and the distance follows from the scale."""
    camera = replace(CAMERA, working_distance_mm=None)
    found = calibrated(RADII[:count], MASKS[:count], camera=camera)
    away = CAMERA.centre_mm[2] - np.mean(RADII[:count])
    assert found.pixel_mm == pytest.approx(away / CAMERA.focal_px, rel=0.003)
    assert [n.code for n in found.warnings if "scale" in n.code] == ["scale-from-spheres"]
    plain = calibrated(None, MASKS[:count], camera=camera)
    assert np.array_equal(found.lights.directions, plain.lights.directions)


def test_spheres_are_searched_for_at_any_size_without_a_distance():
    camera = replace(CAMERA, working_distance_mm=None)
    found = calibrated(RADII, None, camera=camera)
    away = CAMERA.centre_mm[2] - np.mean(RADII)
    assert found.pixel_mm == pytest.approx(away / CAMERA.focal_px, rel=0.005)


def test_without_a_radius_there_is_no_scale():
    assert calibrated(None).pixel_mm is None


def test_with_a_camera_it_has_the_scale():
    found = calibrated(RADII, camera=CAMERA)
    assert found.lights.near
    assert found.pixel_mm is None


def test_radii_that_contradict_each_other_are_refused():
    with pytest.raises(EstimateError, match=r"by the spheres, a pixel is 0\.\d+ to 0\.\d+ mm"):
        calibrated([RADII[0], *(1.2 * radius for radius in RADII[1:])])
