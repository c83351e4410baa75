"""Mirror spheres beside an object, in the same images."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from acquisition import DataError, Lights, crop, downscale, exclude, read_source
from calibration import apply_spheres, calibrate_spheres, linear_stack
from processing import reconstruct

SIZE = (200, 300)
OBJECT, BALLS, RADIUS = (150.0, 100.0), [(50.0, 60.0), (255.0, 140.0)], 30.0
OBJECT_RADIUS = 55.0
CIRCLES = [(x, y, RADIUS) for x, y in BALLS]


def directions(count=8):
    azimuth = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.stack([0.6 * np.cos(azimuth), 0.6 * np.sin(azimuth), np.full(count, 0.8)], axis=1)


def normals_of(centre, radius):
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    across, up = (x - centre[0]) / radius, (centre[1] - y) / radius
    square = across**2 + up**2
    return np.dstack([across, up, np.sqrt(np.clip(1 - square, 0, None))]), square < 1


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Return a folder with a matte hemisphere between two mirror spheres under distant lights."""
    folder = tmp_path_factory.mktemp("beside")
    normals, inside = normals_of(OBJECT, OBJECT_RADIUS)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    for i, light in enumerate(directions()):
        image = np.where(inside, 0.5 * np.clip(normals @ light, 0, None), 0.004)
        half = light + np.array([0.0, 0, 1])
        half /= np.linalg.norm(half)
        for centre in BALLS:
            ball = np.clip(RADIUS - np.hypot(x - centre[0], y - centre[1]) + 0.5, 0, 1)
            place = centre[0] + RADIUS * half[0], centre[1] - RADIUS * half[1]
            spot = 0.8 * np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / (2 * 1.2**2))
            image = image * (1 - ball) + (0.1 + spot) * ball
        cv2.imwrite(str(folder / f"L{i:02d}.png"), np.rint(65535 * image).astype(np.uint16))
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
