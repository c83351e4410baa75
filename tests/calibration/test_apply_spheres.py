"""Mirror spheres next to an object, in the same images."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import DataError, Lights, crop, downscale, exclude, read_source
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


def angles_deg(a, b):
    cross = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.degrees(np.arctan2(cross, np.sum(a * b, axis=-1)))


def calibrated(source):
    stack = linear_stack(replace(source, lights=None))
    spheres = calibrate_spheres(stack, circles=CIRCLES)
    return apply_spheres(source, spheres), spheres


def test_lights_come_from_the_spheres_and_the_mask_leaves_them_out(recording):
    source, spheres = calibrated(read_source(recording))
    assert angles_deg(source.lights.directions, directions()).max() < 0.4
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
    assert angles_deg(result.stereo.normal_map.normals, normals)[middle].mean() < 0.4


def test_a_mask_of_the_recording_also_leaves_them_out(recording):
    whole = replace(read_source(recording), mask=np.ones(SIZE, bool))
    source, _ = calibrated(whole)
    result = reconstruct(source, method="ls", surface=False)
    np.testing.assert_array_equal(result.mask, ~source.not_object)


def test_intensities_of_the_recording_stay(recording):
    strengths = np.linspace(0.5, 1.5, 8)
    known = replace(
        read_source(recording),
        lights=Lights(directions=np.tile((0.0, 0, 1), (8, 1)), intensities=strengths),
    )
    source, _ = calibrated(known)
    np.testing.assert_array_equal(source.lights.intensities[:, 0], strengths)
    assert angles_deg(source.lights.directions, directions()).max() < 0.4


def test_a_region_and_other_lights_are_refused(recording):
    whole = read_source(recording)
    _, spheres = calibrated(whole)
    with pytest.raises(DataError, match="before cropping"):
        apply_spheres(crop(whole, 0, 0, 200, 200), spheres)
    with pytest.raises(DataError, match="are not those of the images"):
        apply_spheres(exclude(whole, ["L03"]), spheres)


def test_a_region_keeps_its_part_of_the_spheres(recording):
    source, _ = calibrated(read_source(recording))
    part = crop(source, 20, 30, 100, 80)
    np.testing.assert_array_equal(part.not_object, source.not_object[30:110, 20:120])
    blocks = source.not_object.reshape(100, 2, 150, 2)
    np.testing.assert_array_equal(downscale(source, 2).not_object, blocks.any(axis=(1, 3)))
