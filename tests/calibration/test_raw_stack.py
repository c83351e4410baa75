"""Linear images that are made from raw frames where they are read."""

import cv2
import numpy as np
import pytest

from acquisition import SRGB, Lights, read_source, write_png
from calibration import EstimateError, calibrate_spheres, linear_stack, open_stack, raw_stack
from calibration.radiance import LazyValues
from calibration.spheres import sphere_candidates
from sgp.app import build, run
from simulator import render, scene_named

SIZE = (45, 70)


@pytest.fixture
def grey(tmp_path):
    """Five images with saturated parts, without lights."""
    rng = np.random.default_rng(0)
    for i in range(5):
        pixels = rng.integers(0, 60000, SIZE).astype(np.uint16)
        pixels[3 * i : 3 * i + 5, 20:26] = 65535
        write_png(tmp_path / f"L{i:02d}.png", pixels)
    return tmp_path


@pytest.mark.parametrize(
    "key",
    [
        (slice(None), slice(3, 20), slice(10, 60)),
        (slice(None, None, 2), slice(None, None, 7), slice(None, None, 7)),
        (slice(None), slice(40, 99)),
        ([3, 1], slice(0, 5)),
        (2, slice(7, 9), slice(1, 4)),
        (slice(None), np.array([2, 30]), np.array([5, 66])),
        (1, np.array([[[2], [3]]]), np.array([[[4, 5]]])),
        3,
    ],
    ids=["box", "steps", "rows", "lights", "one light", "points", "blocks", "image"],
)
@pytest.mark.parametrize("transfer", ["linear", "srgb"])
def test_its_parts_are_those_of_the_linear_stack(grey, key, transfer):
    source = read_source(grey, transfer=SRGB if transfer == "srgb" else None)
    whole = linear_stack(source).values
    with open_stack(source) as opened:
        for stack in (raw_stack(source), opened):
            part = stack.values[key]
            assert part.dtype == np.float32
            np.testing.assert_array_equal(part, whole[key])


def test_some_of_the_lights_are_a_stack(grey):
    source = read_source(grey, lights=Lights(np.eye(3)[[0, 1, 2, 0, 1]] + 1, None, range(1, 6)))
    whole, stack = linear_stack(source), raw_stack(source)
    some = stack.take([4, 0])
    assert isinstance(some.values, LazyValues)
    assert (some.ids, some.values.shape, len(some.values)) == (("L04", "L00"), (2, *SIZE), 2)
    assert some.peaks == (stack.peaks[4], stack.peaks[0])
    np.testing.assert_array_equal(some.values[:, 0:3], whole.values[[4, 0], 0:3])
    assert len(stack.values[::2]) == 3
    brightest = np.nan_to_num(np.maximum.reduce(whole.values), nan=1.0)
    assert np.count_nonzero(brightest == 1) > 100
    np.testing.assert_array_equal(stack.brightest, brightest)


@pytest.mark.parametrize("kind", ["8-bit sRGB", "colour", "brackets and dark frames"])
def test_other_frames_have_the_same_values(tmp_path, kind):
    rng = np.random.default_rng(1)
    if kind == "brackets and dark frames":
        words = ["simulate", "spheres", "--led-count", "3", "--size", "96x80", "--out"]
        assert run(build(), [*words, str(tmp_path / "session")]) == 0
        source = read_source(tmp_path / "session")
        assert len({frame.role for frame in source.frames}) > 1
        assert len({frame.bracket for frame in source.frames}) == 2
    else:
        shape = (*SIZE, 3) if kind == "colour" else SIZE
        for i in range(3):
            pixels = rng.integers(0, 256, shape).astype(np.uint8)
            cv2.imwrite(str(tmp_path / f"L{i}.png"), pixels)
        source = read_source(tmp_path, transfer=SRGB)
    whole, stack = linear_stack(source), raw_stack(source)
    np.testing.assert_array_equal(stack.values[:, 5:40, 11:50], whole.values[:, 5:40, 11:50])
    assert stack.ids == whole.ids
    assert stack.warnings == whole.warnings


def test_black_images_are_refused(tmp_path):
    for i in range(3):
        write_png(tmp_path / f"L{i}.png", np.zeros(SIZE, np.uint16))
    with pytest.raises(EstimateError, match="all 3 images are black"):
        raw_stack(read_source(tmp_path))


def recorded(folder, width, height):
    """Write images of spheres; return their source and the truth."""
    rendering = render(scene_named("spheres", width=width, height=height, leds=4))
    scale = 9000 / np.median(rendering.planes)
    for i, plane in enumerate(rendering.planes):
        clipped = np.clip(np.rint(scale * plane), 0, 65535)
        write_png(folder / f"L{i:02d}.png", clipped.astype(np.uint16))
    return read_source(folder), rendering.truth


@pytest.mark.slow
def test_marked_spheres_in_raw_frames_are_those_in_linear_images(tmp_path):
    source, truth = recorded(tmp_path, 160, 128)
    options = {"masks": list(truth.sphere_masks), "camera": truth.camera}
    whole = calibrate_spheres(linear_stack(source), **options)
    raw = calibrate_spheres(raw_stack(source), **options)
    np.testing.assert_array_equal(raw.lights.directions, whole.lights.directions)
    np.testing.assert_array_equal(raw.lights.errors.covariances, whole.lights.errors.covariances)


@pytest.mark.slow
def test_spheres_found_in_raw_frames_are_those_in_linear_images(tmp_path):
    """More than 900 px: the search uses a lower resolution, and parts of the images."""
    source, truth = recorded(tmp_path, 960, 768)
    options = {"camera": truth.camera, "radius_mm": [20, 20, 16, 14]}
    whole = calibrate_spheres(linear_stack(source), **options)
    raw = calibrate_spheres(raw_stack(source), **options)
    assert len(raw.spheres) == 4
    assert [s.outline for s in raw.spheres] == [s.outline for s in whole.spheres]
    np.testing.assert_array_equal(raw.lights.positions_mm, whole.lights.positions_mm)
    circles = [
        [one.circle_px for one in sphere_candidates(stack(source), camera=truth.camera)]
        for stack in (linear_stack, raw_stack)
    ]
    assert circles[0] == circles[1]
