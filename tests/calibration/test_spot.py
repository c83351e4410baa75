"""Centres of drawn highlights whose truth is known: rays, glare, saturation, noise."""

import numpy as np
import pytest

from calibration.spheres import Ellipse, find_highlights
from calibration.spheres.highlights.spot import Spot, saturated_spot, unsaturated_spot

CENTRE = np.array([40.3, 36.6])
Y, X = np.indices((75, 80)) - CENTRE[::-1, None, None]
R = np.hypot(X, Y)


def core(radius_px, peak=30.0):
    """Return a Gaussian that crosses white at a radius."""
    return peak * np.exp(-np.log(peak) * (R / radius_px) ** 2)


def ray(angle_deg, length_px, width_px=1.0):
    """Return a ray that is above white up to a length."""
    angle = np.radians(angle_deg)
    along, across = X * np.cos(angle) + Y * np.sin(angle), Y * np.cos(angle) - X * np.sin(angle)
    shape = 2.0 * np.exp(-along * np.log(2) / length_px) * np.exp(-((across / width_px) ** 2))
    return np.where(along > 0, shape, 0.0)


def located(light):
    image = np.minimum(light, 1).astype(np.float32)
    spot = saturated_spot(image, image > 0.84, 1.0)
    return spot.centre - CENTRE, spot.sigma_px


@pytest.mark.parametrize(("radius_px", "bound_px"), [(1.5, 0.2), (3, 0.1), (6, 0.05), (12, 0.05)])
def test_a_core_without_rays(radius_px, bound_px):
    error, sigma_px = located(core(radius_px))
    assert np.abs(error).max() < bound_px
    assert 0.01 < sigma_px < 0.13


@pytest.mark.parametrize("radius_px", [4, 8])
@pytest.mark.parametrize(
    "rays",
    [[10], [10, 40], [0, 60, 120, 180, 240, 300], [5, 17, 120, 200]],
    ids=["one", "two near", "star", "uneven"],
)
def test_rays_do_not_move_the_centre(radius_px, rays):
    light = core(radius_px) + sum(ray(angle, 2.5 * radius_px) for angle in rays)
    error, sigma_px = located(light)
    assert np.hypot(*error) < 0.12
    assert sigma_px < 0.25
    bright = light >= 0.98
    moved = np.hypot(X[bright].mean(), Y[bright].mean())
    assert len(rays) == 6 or moved > 0.3


def test_an_elliptic_core():
    turn = np.radians(25)
    along, across = X * np.cos(turn) + Y * np.sin(turn), Y * np.cos(turn) - X * np.sin(turn)
    error, _ = located(30 * np.exp(-np.log(30) * ((along / 7) ** 2 + (across / 5) ** 2)))
    assert np.hypot(*error) < 0.05


def test_glare_on_one_side_moves_the_centre_little_and_raises_the_sigma():
    glare = 0.35 * np.exp(-((X - 9) ** 2 + Y**2) / (2 * 8.0**2))
    _, sigma_px = located(core(5))
    error, with_glare_px = located(core(5) + glare)
    assert np.hypot(*error) < 0.3
    assert with_glare_px > 1.5 * sigma_px
    assert np.hypot(*error) < 3 * with_glare_px


@pytest.mark.parametrize(
    ("around", "bound_px", "sigma_px"),
    [
        pytest.param(0.7, 0.1, (0.01, 0.13), id="above the lower level"),
        pytest.param(1.0, 1.0, (3.0, 20.0), id="saturated"),
    ],
)
def test_a_core_in_a_bright_patch_without_a_contour(around, bound_px, sigma_px):
    image = np.maximum(np.minimum(core(3), 1), around).astype(np.float32)
    spot = saturated_spot(image, (image > 0.84) & (R < 4), 1.0)
    assert np.abs(spot.centre - CENTRE).max() < bound_px
    assert sigma_px[0] < spot.sigma_px < sigma_px[1]


def test_the_sigma_of_an_unsaturated_peak_is_that_of_its_noise():
    rng = np.random.default_rng(2)
    light = 0.5 * np.exp(-(R**2) / (2 * 1.5**2))
    region = light > 0.15
    spots = [
        unsaturated_spot((light + rng.normal(0, 0.03, R.shape)).astype(np.float32), region, 0.03)
        for _ in range(60)
    ]
    error = np.array([spot.centre - CENTRE for spot in spots])
    sigma_px = np.array([spot.sigma_px for spot in spots])
    share = np.sqrt(np.mean((error / sigma_px[:, None]) ** 2))
    assert 0.6 < share < 1.2
    assert np.sqrt(np.mean(error**2)) > 0.03
    quiet = unsaturated_spot(light.astype(np.float32), region, 0.0)
    assert quiet.sigma_px == pytest.approx(0.01, abs=0.005)


@pytest.mark.parametrize("photons", [2e3, 2e4])
def test_the_photon_noise_of_a_peak_is_that_of_repeated_exposures(photons):
    """One photon has the brightness 1 / photons of the peak."""
    rng = np.random.default_rng(4)
    light = np.exp(-(R**2) / (2 * 1.5**2))
    exposures = (rng.poisson(photons * light, (200, *R.shape)) / photons).astype(np.float32)
    spots = [unsaturated_spot(one, light > 0.3, 0.0) for one in exposures]
    error = np.sqrt(np.mean([np.square(spot.centre - CENTRE) for spot in spots]))
    stated = np.sqrt(np.mean([spot.photon_px2 for spot in spots]) / photons)
    assert error == pytest.approx(stated, rel=0.15)


def test_a_streaked_highlight_is_found_and_a_fainter_second_one_ignored():
    """The rays cover more than the largest allowed disc, and glare half of the sphere."""
    light = core(5, 300.0) + sum(ray(a, 18, 1.5) for a in range(15, 375, 60))
    light += 0.3 * np.exp(-(R**2) / (2 * 12.0**2))
    light[60:62, 20:22] = 2.0
    image = np.where(light >= 1, np.nan, light).astype(np.float32)
    found = find_highlights(image[None], Ellipse.circle(40.0, 37.0, 36.0))
    assert found.saturated.all()
    assert np.abs(found.pixels[0] - CENTRE).max() < 0.15
    assert found.sigma_px[0] < 0.3


def test_the_core_decides_which_saturated_highlight_is_wide():
    """A saturated matte surface is no highlight."""
    image = np.where(core(13, 2.0) >= 1, np.nan, core(13, 2.0)).astype(np.float32)
    assert not find_highlights(image[None], Ellipse.circle(40.0, 37.0, 36.0)).found.any()


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
