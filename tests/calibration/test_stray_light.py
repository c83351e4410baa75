"""Errors of highlights whose large saturated core is mostly stray light."""

import numpy as np
import pytest

from calibration.spheres.highlights.spot import Spot, saturated_spot


def halo(scale_px: float, skew_px: float, ray: float = 0.0) -> Spot:
    """Locate light at (80, 80) with a halo whose contours move up as they get larger, and a ray."""
    y, x = np.mgrid[:160, :160].astype(np.float64)
    distance = np.hypot(x - 80, y - 80)
    up = np.hypot(x - 80, y - 80 + skew_px * np.minimum(distance / scale_px, 1.0))
    image = 2 / (1 + (up / scale_px) ** 2) + ray * np.exp(-((x - 80) ** 2) / (2 * scale_px**2))
    spot = saturated_spot(np.minimum(image, 1).astype(np.float32), image >= 0.3, 1.0)
    assert np.hypot(*(spot.centre - 80)) < 3 * np.sqrt(2) * np.hypot(spot.sigma_px, spot.stray_px)
    return spot


@pytest.mark.parametrize("scale_px", [12.0, 20.0, 30.0])
@pytest.mark.parametrize("skew_px", [0.0, 1.5])
def test_the_error_of_a_large_soft_core_grows_with_it(scale_px, skew_px):
    spot = halo(scale_px, skew_px)
    assert 0.02 * scale_px < spot.stray_px < 0.2 * scale_px


def test_small_cores_have_no_stray_light():
    assert halo(5.0, 0.0).stray_px == 0


def test_a_ray_as_wide_as_the_core_adds_to_the_error():
    assert halo(12.0, 0.0, ray=0.5).stray_px > 1.5 * halo(12.0, 0.0).stray_px
