"""Spheres in images of a camera that drifts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from acquisition import Source, angle_deg, read_source, write_png
from calibration import EstimateError, apply_spheres, calibrate_spheres
from calibration.radiance import moved_values, raw_stack
from calibration.spheres import SphereCalibration
from rig.arrays import Float32, Float64, UInt16
from tests.calibration.spheres_and_object import directions, printed

EVERY = [f"L{k:02d}" for k in range(8)]


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> UInt16:
    return np.asarray(printed(tmp_path_factory.mktemp("still")), np.uint16)


def drifting() -> Float64:
    across = np.linspace(-8, 8, 8)
    return np.rint(np.stack([across, -across / 2], axis=1))


def stack_of(images: UInt16, shifts: Float64) -> Float32:
    moved = [np.roll(i, (int(d), int(r)), (0, 1)) for i, (r, d) in zip(images, shifts, strict=True)]
    return np.array(moved, np.float32) / np.float32(65535)


def calibrated(images: UInt16, shifts: Float64, follow: bool = True) -> SphereCalibration:
    return calibrate_spheres(stack_of(images, shifts), follow=follow)


def test_the_camera_is_followed(images: UInt16) -> None:
    shifts = drifting()
    found = calibrated(images, shifts)
    assert found.lights.ids == tuple(EVERY)
    assert angle_deg(found.lights.unit_directions, directions()).max() < 1.2
    measured = np.array([found.shifts_px[name] for name in EVERY])
    error = measured - shifts
    assert np.abs(error - np.median(error, axis=0)).max() < 0.35
    with pytest.raises(EstimateError):
        calibrated(images, shifts, follow=False)


def test_a_camera_that_stands_still_is_not_followed(images: UInt16) -> None:
    still = np.zeros((8, 2))
    followed, plain = calibrated(images, still), calibrated(images, still, follow=False)
    assert followed.shifts_px == {}
    np.testing.assert_array_equal(followed.lights.directions, plain.lights.directions)


@pytest.mark.slow
def test_an_image_without_the_sphere_is_left_out(images: UInt16) -> None:
    shifts = drifting()
    shifts[7] = -45, 0
    found = calibrated(images, shifts)
    assert found.lights.ids == tuple(EVERY[:7])
    texts = [str(one) for one in found.warnings if one.code == "image-displaced"]
    assert len(texts) == 1
    assert "light L07: " in texts[0]
    assert "outside the image" in texts[0]


def test_too_many_images_without_the_sphere_are_refused(images: UInt16) -> None:
    shifts = drifting()
    shifts[5:] = -45, 0
    with pytest.raises(EstimateError, match=r"light L0\d: the sphere"):
        calibrated(images, shifts)


@pytest.mark.slow
def test_the_source_gets_the_shifts(images: UInt16, tmp_path: Path) -> None:
    for name, image in zip(EVERY, stack_of(images, drifting()), strict=True):
        write_png(tmp_path / f"{name}.png", np.rint(65535 * image).astype(np.uint16))
    source: Source = read_source(tmp_path)
    found = calibrate_spheres(raw_stack(source), follow=True)
    assert apply_spheres(source, found).shifts_px == found.shifts_px


def test_parts_of_images_are_moved_as_complete_ones() -> None:
    values = np.random.default_rng(1).uniform(0, 1, (2, 12, 15)).astype(np.float32)
    moved = moved_values(values, np.array([[1.25, -2.5], [0, 3]]))
    complete = moved[0]
    wanted = 0.75 * values[0, :, 3] + 0.25 * values[0, :, 4]  # of column 2
    assert complete[5, 2] == pytest.approx((wanted[2] + wanted[3]) / 2, rel=1e-5)
    np.testing.assert_array_equal(moved[0, 3:7, ::2], complete[3:7, ::2])
    at = np.array([0, 4, 11]), np.array([14, 2, 0])
    np.testing.assert_array_equal(moved[0, at[0], at[1]], complete[at])
    np.testing.assert_array_equal(moved[1][:9], values[1][3:])
