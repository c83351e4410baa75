"""Shifts by fractions of a pixel, tested with images that are known between their pixels."""

import numpy as np
import pytest

from simulator.camera.virtual_sensor import shifted

Y, X = np.mgrid[:60, :80].astype(np.float64)
INNER = (slice(20, -20), slice(20, -20))


def waves(x, y, period):
    return 100 + 40 * np.sin(2 * np.pi * (x - 0.3 * y) / period) + 30 * np.cos(2 * np.pi * y / 11)


@pytest.mark.parametrize("shift", [(0.1, 0.0), (0.0, -0.07), (-0.5, 0.31), (1.4, -2.3)])
def test_waves_of_six_pixels_are_shifted_correctly(shift):
    moved = shifted(waves(X, Y, 6.0).astype(np.float32), shift, mosaic=False)
    expected = waves(X - shift[0], Y - shift[1], 6.0)
    # 2e-4 along each axis of an amplitude of 70.
    assert np.abs(moved - expected)[INNER].max() < 0.03
    assert moved.dtype == np.float32


def test_a_blurred_spot_is_shifted_and_keeps_its_sum():
    plane = np.exp(-((X - 40) ** 2 + (Y - 30) ** 2) / (2 * 1.2**2)).astype(np.float32)
    moved = shifted(plane, (0.23, -0.41), mosaic=False).astype(np.float64)
    assert moved.sum() == pytest.approx(plane.sum(), rel=1e-3)
    centre = (moved * X).sum() / moved.sum(), (moved * Y).sum() / moved.sum()
    assert centre == pytest.approx((40.23, 29.59), abs=2e-3)
    assert moved.min() >= 0


@pytest.mark.parametrize("mosaic", [False, True])
def test_no_shift_changes_nothing(mosaic):
    plane = np.random.default_rng(0).uniform(0, 9, (20, 31)).astype(np.float32)
    np.testing.assert_allclose(shifted(plane, (0.0, 0.0), mosaic=mosaic), plane, rtol=1e-6)


def test_colours_of_a_mosaic_do_not_mix():
    """Each filter has its own wave, which must be shifted as in an image of one colour."""
    amount = np.array([[1.0, 5.0], [20.0, 100.0]])
    filters = np.tile(amount, (30, 40))
    shift = (0.13, -0.21)
    moved = shifted((filters * waves(X, Y, 16.0)).astype(np.float32), shift, mosaic=True)
    expected = filters * waves(X - shift[0], Y - shift[1], 16.0)
    np.testing.assert_allclose(moved[INNER], expected[INNER], rtol=1e-3)
    # Colours do not mix at the edges either, where the image is continued by its mirror image.
    flat = shifted(filters.astype(np.float32), shift, mosaic=True)
    np.testing.assert_allclose(flat, filters, rtol=1e-5)


def test_an_image_smaller_than_the_kernel():
    plane = np.full((1, 3), 7.0, np.float32)
    np.testing.assert_allclose(shifted(plane, (0.2, 0.2), mosaic=False), plane, rtol=1e-6)
