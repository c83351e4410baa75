"""Mirror spheres next to an object, in the same images."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import (
    DataError,
    LightErrors,
    Lights,
    angle_deg,
    crop,
    downscale,
    exclude,
    read_source,
)
from calibration import apply_spheres, calibrate_spheres, linear_stack
from processing import reconstruct
from tests.calibration.spheres_and_object import (
    BALLS,
    CIRCLES,
    OBJECT,
    OBJECT_RADIUS,
    RADIUS,
    SIZE,
    directions,
    normals_of,
    write_recording,
)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recording")
    write_recording(folder)
    return folder


@pytest.fixture(scope="module")
def spheres(recording):
    """Return the calibration from the images, which no test changes."""
    return calibrate_spheres(linear_stack(read_source(recording)), circles=CIRCLES)


def test_lights_come_from_the_spheres_and_the_mask_leaves_them_out(recording, spheres):
    source = apply_spheres(read_source(recording), spheres)
    assert angle_deg(source.lights.directions, directions()).max() < 0.4
    assert spheres.lights.ids == source.lights.ids
    for centre in BALLS:
        _, ball = normals_of(centre, RADIUS)
        assert source.not_object[ball].all()
    normals, truth = normals_of(OBJECT, OBJECT_RADIUS)
    assert not (source.not_object & truth).any()

    result = reconstruct(source, method="ls", surface=False)
    assert not (result.mask & source.not_object).any()
    assert np.count_nonzero(result.mask ^ truth) < 0.03 * truth.sum()
    middle = normals_of(OBJECT, 0.7 * OBJECT_RADIUS)[1]  # lit by every light
    assert angle_deg(result.normals.normals, normals)[middle].mean() < 0.4


def test_a_mask_of_the_recording_also_leaves_them_out(recording, spheres):
    whole = replace(read_source(recording), mask=np.ones(SIZE, bool))
    source = apply_spheres(whole, spheres)
    result = reconstruct(source, method="ls", surface=False)
    np.testing.assert_array_equal(result.mask, ~source.not_object)


def test_intensities_of_the_recording_stay(recording, spheres):
    strengths = np.linspace(0.5, 1.5, 8)
    errors = LightErrors(np.tile(4.0 * np.eye(2), (8, 1, 1)), intensity_std=0.01 * strengths)
    known = replace(
        read_source(recording),
        lights=Lights(np.tile((0.0, 0, 1), (8, 1)), intensities=strengths, errors=errors),
    )
    source = apply_spheres(known, spheres)
    np.testing.assert_array_equal(source.lights.intensities[:, 0], strengths)
    assert angle_deg(source.lights.directions, directions()).max() < 0.4
    # Each value keeps the error of the recording from which it was estimated.
    np.testing.assert_array_equal(source.lights.errors.intensity_std[:, 0], 0.01 * strengths)
    np.testing.assert_array_equal(
        source.lights.errors.covariances, spheres.lights.errors.covariances
    )
    assert source.lights.errors.mu_std is None


def test_axes_and_falloff_of_near_lights_stay_with_their_errors(recording, spheres):
    places = 400 * directions()
    near = replace(
        spheres, lights=Lights(positions_mm=places, errors=LightErrors(residual_px=np.ones(8)))
    )
    row = np.linspace(0.1, 0.2, 8)
    errors = LightErrors(axis_std_deg=row, mu_std=2 * row, residual_px=row)
    known = replace(
        read_source(recording), lights=Lights(positions_mm=places + 9, mu=row, errors=errors)
    )
    found = apply_spheres(known, near).lights
    np.testing.assert_array_equal(found.positions_mm, places)
    np.testing.assert_array_equal(found.mu, row)
    np.testing.assert_array_equal(found.errors.mu_std, 2 * row)
    np.testing.assert_array_equal(found.errors.axis_std_deg, row)
    np.testing.assert_array_equal(found.errors.residual_px, np.ones(8))


def test_a_region_and_other_lights_are_refused(recording, spheres):
    whole = read_source(recording)
    with pytest.raises(DataError, match="before cropping"):
        apply_spheres(crop(whole, 0, 0, 200, 200), spheres)
    with pytest.raises(DataError, match="are not those of the images"):
        apply_spheres(exclude(whole, ["L03"]), spheres)


def test_images_of_lights_that_the_spheres_do_not_determine_are_left_out(recording, spheres):
    whole = read_source(recording)
    with_lights = replace(whole, lights=Lights(np.eye(8, 3) + 1, intensities=np.arange(1.0, 9)))
    known = [0, 1, 2, 4, 5, 6, 7]
    part = replace(spheres, lights=spheres.lights.take(known))
    lit = apply_spheres(with_lights, part)
    assert lit.light_ids == lit.lights.ids == part.lights.ids
    np.testing.assert_array_equal(lit.lights.intensities[:, 0], np.array(known) + 1)
    turned = replace(spheres, lights=spheres.lights.take(known[::-1]))
    with pytest.raises(DataError, match="in another order"):
        apply_spheres(whole, turned)


def test_a_region_keeps_its_part_of_the_spheres(recording, spheres):
    source = apply_spheres(read_source(recording), spheres)
    part = crop(source, 20, 30, 100, 80)
    np.testing.assert_array_equal(part.not_object, source.not_object[30:110, 20:120])
    blocks = source.not_object.reshape(100, 2, 150, 2)
    np.testing.assert_array_equal(downscale(source, 2).not_object, blocks.any(axis=(1, 3)))
