"""Form removal and filters of roughness."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from acquisition import DataError
from calibration import EstimateError
from processing.maps.local_planes import blurred, fit_planes
from processing.roughness import (
    Resolution,
    Scales,
    fit_form,
    mean_line,
    mean_surface,
    scale_limited,
)

PIXEL = 0.01
Y, X = np.meshgrid(np.arange(120.0), np.arange(160.0), indexing="ij")


@pytest.mark.parametrize("scale", [0.5, 3.0, 8.0, 25.0])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_planes_are_exact_up_to_masks(scale, kind):
    mask = np.random.default_rng(0).random(X.shape) > 0.2
    mask[30:60, 40:90] = False
    values = (0.03 * X - 0.02 * Y + 1).astype(kind)
    found = fit_planes(np.where(mask, values, np.nan), mask, scale)
    assert found.known.sum() > 0.9 * mask.sum()
    # Wide weights are summed on coarser grids, in single precision.
    np.testing.assert_allclose(found.value[found.known], values[found.known], atol=3e-4)
    np.testing.assert_allclose(found.right[found.known], 0.03, atol=1e-4)
    np.testing.assert_allclose(found.up[found.known], 0.02, atol=1e-4)
    assert not found.value[~found.known].any()


def test_wide_planes_are_exact_across_blocks():
    y, x = np.mgrid[:600, :560].astype(np.float32)
    mask = (x - 280) ** 2 + (y - 300) ** 2 < 270**2
    found = fit_planes(np.where(mask, 0.03 * x - 0.02 * y, np.nan), mask, 250.0)
    assert found.known[mask].all()
    np.testing.assert_allclose(found.value[mask], (0.03 * x - 0.02 * y)[mask], atol=4e-3)


@pytest.mark.parametrize("scale", [2.0, 7.0, 20.0, 45.0])
def test_blurs_on_coarser_grids(scale):
    image = np.random.default_rng(1).standard_normal(X.shape).astype(np.float32)
    expected = gaussian_filter(image.astype(float), scale, mode="constant", truncate=6)
    np.testing.assert_allclose(blurred(image, scale), expected, atol=2e-4 * expected.std())


@pytest.mark.parametrize("nesting", [10.0, 40.0, 90.0])
@pytest.mark.parametrize("wave", [20.0, 45.0])
def test_transmission_of_the_gaussian_filter(nesting, wave):
    x = np.arange(700.0)
    heights = np.cos(2 * np.pi * (x - 350) / wave) * np.ones((60, 1))
    expected = np.exp(-np.log(2) * (nesting / wave) ** 2)
    assert mean_line(heights[0], nesting)[350] == pytest.approx(expected, abs=2e-5)
    if nesting < 60:
        assert mean_surface(heights, nesting)[30, 350] == pytest.approx(expected, abs=1e-3)


def test_filters_keep_slopes_at_ends_and_holes():
    line = 3 * np.arange(200.0) + 1
    line[:3] = np.nan
    np.testing.assert_allclose(mean_line(line, 50), line)
    plane = np.where((X - 80) ** 2 + (Y - 60) ** 2 < 55**2, 0.1 * X - 0.2 * Y, np.nan)
    np.testing.assert_allclose(mean_surface(plane, 20), plane, atol=1e-9)


def test_robust_filters_ignore_scratches():
    rough = np.random.default_rng(2).normal(scale=0.1, size=X.shape)
    scratched = rough.copy()
    scratched[:, 70:74] -= 20
    for robust in (False, True):
        surface = mean_surface(scratched, 60, robust=robust) - mean_surface(rough, 60)
        line = mean_line(scratched[60], 60, robust=robust) - mean_line(rough[60], 60)
        assert (np.abs(surface[:, 50:68]).max() < 0.1) == robust
        assert (np.abs(line[50:68]).max() < 0.1) == robust


def test_the_blur_of_the_instrument_is_a_part_of_the_s_filter():
    relief = gaussian_filter(np.random.default_rng(3).normal(size=X.shape), 3, mode="wrap")
    area = np.zeros(X.shape, bool)
    area[30:90, 30:130] = True
    scales = Scales("plane", 0.1, 0.0)
    sharp = scale_limited(relief, area, scales, Resolution(PIXEL, 0.0))
    for blur in (0.5, 0.8, 1.2):
        seen = gaussian_filter(relief, blur, mode="wrap")
        found = scale_limited(seen, area, scales, Resolution(PIXEL, blur))
        np.testing.assert_allclose(found[area], sharp[area], atol=1e-2 * np.nanstd(sharp))
    assert np.isnan(sharp[~area]).all()


POLYNOMIALS = {
    "level": 3 + 0 * X,
    "plane": 0.1 * X - 0.3 * Y,
    "quadric": 0.01 * X**2 - 0.02 * X * Y,
    "cubic": 1e-4 * X**3 - 1e-4 * X * Y**2,
    "quartic": 1e-6 * X**4,
    "quintic": 1e-8 * X**3 * Y**2,
}


@pytest.mark.parametrize("form", POLYNOMIALS)
@pytest.mark.parametrize("robust", [False, True])
def test_polynomials_are_removed(form, robust):
    surface = POLYNOMIALS[form]
    mask = (X - 80) ** 2 + (Y - 60) ** 2 < 55**2
    found = fit_form(np.where(mask, surface, np.nan), 1.0, form, robust=robust)
    np.testing.assert_allclose(
        found.heights[mask], surface[mask], atol=1e-6 * np.ptp(surface) + 1e-9
    )


def test_a_robust_form_ignores_what_is_not_the_form():
    surface = 0.1 * X + np.random.default_rng(4).normal(scale=0.01, size=X.shape)
    surface[:40, :60] += 5
    found = fit_form(surface, 1.0, "plane", robust=True).heights
    np.testing.assert_allclose(found, 0.1 * X, atol=0.01)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("robust", [False, True])
def test_spheres_and_cylinders(side, robust):
    noise = np.random.default_rng(5).normal(scale=1e-3, size=X.shape)
    x, y = (X - 60) * PIXEL, (70 - Y) * PIXEL
    radius = 4.0
    sphere = side * np.sqrt(radius**2 - x**2 - y**2)
    found = fit_form(sphere + noise, PIXEL, "sphere", robust=robust)
    assert found.radius == pytest.approx(side * radius, rel=2e-3)
    np.testing.assert_allclose(found.heights, sphere, atol=3e-4)
    across = np.cos(0.4) * x + np.sin(0.4) * y
    cylinder = side * np.sqrt(radius**2 - across**2)
    found = fit_form(cylinder + noise, PIXEL, "cylinder", robust=robust)
    assert found.radius == pytest.approx(side * radius, rel=2e-3)
    np.testing.assert_allclose(found.heights, cylinder, atol=3e-4)


def test_forms_that_do_not_fit():
    flat = np.random.default_rng(6).normal(scale=1e-9, size=X.shape)
    with pytest.raises(EstimateError, match="too flat for a sphere"):
        fit_form(flat, PIXEL, "sphere")
    few = np.full(X.shape, np.nan)
    few[5, 5:20] = 1
    with pytest.raises(EstimateError, match=r"few lines|too few"):
        fit_form(few, PIXEL, "quadric")
    with pytest.raises(EstimateError, match="too few"):
        fit_form(np.full(X.shape, np.nan), PIXEL, "cylinder")


REFUSED = {
    "S-filter below the resolution": (Scales(s_mm=0.02), 3.0, "below what the images resolve"),
    "L-filter below the S-filter": (Scales(s_mm=0.5, l_mm=0.25), 3.0, "leaves nothing"),
    "small area": (Scales(l_mm=0.8), 0.5, "the smallest area is 0.8 mm"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_scales_that_are_refused(name):
    scales, side, message = REFUSED[name]
    with pytest.raises(DataError, match=message):
        scales.resolved(Resolution(PIXEL, 0.7), side)


def test_default_scales_are_those_of_the_standard():
    found = Scales().resolved(Resolution(PIXEL, 0.7), 5.0)
    assert (found.s_mm, found.l_mm) == (0.05, 1.0)
    blurred_more = Scales().resolved(Resolution(PIXEL, 2.0), 5.0)
    assert blurred_more.s_mm == 0.2
    assert Scales().resolved(Resolution(PIXEL), 0.1).l_mm == 0
