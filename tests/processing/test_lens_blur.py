"""Errors by the blur of the lens, by light from other parts, and those that all pixels share."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from acquisition import DataError, Lights, angle_deg
from calibration import StackNoise
from processing import photometric_stereo
from processing.noise import UNIFORM_DEG, LensBlur, SampleKind, lens_blur, normal_uncertainty
from processing.noise.inconsistency import Inconsistency
from processing.noise.interreflection import reflected_variance
from processing.recording.reconstruction import with_common_error
from tests.processing.scenes import dome, half_ball
from tests.quick_sample import quick

SIZE = (240, 260)
WHOLE = slice(0, SIZE[0])


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=2, keepdims=True)


def plates(seed, side=11, spread=0.25):
    """Return unit normals of plates, turned against rows and columns, averaged over each pixel."""
    rng = np.random.default_rng(seed)
    y, x = np.indices((4 * SIZE[0], 4 * SIZE[1])) / 4
    along, across = x + 0.4 * y + 200, y - 0.4 * x + 200
    tilts = rng.normal(0, spread, (60, 60, 2))
    chosen = tilts[(along // side).astype(int), (across // side).astype(int)]
    fine = unit(np.dstack([chosen, np.ones(chosen.shape[:2])]))
    return unit(cv2.resize(fine, SIZE[::-1], interpolation=cv2.INTER_AREA))


def waves(period):
    y, x = np.indices(SIZE)
    slope = 0.2 * np.sin(2 * np.pi * (x + 0 * y) / period)
    return unit(np.dstack([slope, 0 * slope, np.ones(SIZE)]))


def seen(normals, width, noise=0.0, seed=7):
    """Return normals as a lens blurs them, with noise of this variance in both directions."""
    rng = np.random.default_rng(seed)
    blurred = cv2.GaussianBlur(normals, (0, 0), width)
    return unit(blurred + np.sqrt(noise / 2) * rng.normal(size=normals.shape)).astype(np.float32)


@pytest.mark.parametrize("width", [0.5, 0.7, 1.0, 1.3])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_width_is_found_from_edges(width, seed):
    noise = np.full(SIZE, 1e-5, np.float32)
    found = lens_blur(seen(plates(seed), width, 1e-5), noise, np.ones(SIZE, bool))
    assert found.shown
    assert width / 1.35 < found.sigma_px < 1.35 * width


@pytest.mark.parametrize("width", quick([0.6, 0.8, 1.1], every=2))
@pytest.mark.parametrize("normals", [plates(3), plates(4, side=20)], ids=["fine", "coarse"])
def test_errors_of_blurred_edges_are_as_large_as_stated(normals, width):
    noise = np.full(SIZE, 1e-5, np.float32)
    given, valid = seen(normals, width, 1e-5), np.ones(SIZE, bool)
    found = lens_blur(given, noise, valid)
    stated = np.sqrt(found.variance(given, noise, valid, WHOLE) + noise)
    error = np.radians(angle_deg(given, normals))
    ratio = np.sqrt(np.mean(error**2) / np.mean(stated**2))
    assert 0.5 < ratio < 2, ratio
    order = np.array_split(np.argsort(stated.ravel()), 5)
    parts = [np.sqrt(np.mean(error.ravel()[part] ** 2)) for part in order]
    assert parts[-1] > 3 * parts[0]


@pytest.mark.parametrize("period", [6, 9, 20])
def test_a_wave_loses_what_its_frequency_loses(period):
    """Closed form: a second blur removes h (1 - h) of a frequency, the first one removed 1 - h."""
    width = 0.8
    left = np.exp(-0.5 * (2 * np.pi * width / period) ** 2)
    given, valid = seen(waves(period), width), np.ones(SIZE, bool)
    nothing = np.zeros(SIZE, np.float32)
    variance = LensBlur(width, 1 / left, True).variance(given, nothing, valid, WHOLE)
    error = np.radians(angle_deg(given, waves(period)))
    inner = np.s_[20:-20, 20:-20]
    ratio = np.sqrt(np.mean(error[inner] ** 2) / np.mean(variance[inner]))
    assert ratio == pytest.approx(1, abs=0.06)


def test_noise_is_not_detail():
    noise = np.full(SIZE, 4e-4, np.float32)
    given, valid = seen(np.tile([0.0, 0.0, 1.0], (*SIZE, 1)), 0.7, 4e-4), np.ones(SIZE, bool)
    found = lens_blur(given, noise, valid)
    assert (found.sigma_px, found.shown) == (0.7, False)
    variance = found.variance(given, noise, valid, WHOLE)
    assert np.mean(variance) < 0.25 * 4e-4


@pytest.mark.parametrize("rows", [slice(0, 240), slice(0, 1), slice(33, 34), slice(100, 171)])
def test_rows_are_those_of_the_whole(rows):
    valid = np.hypot(*(np.indices(SIZE) - 120.0)) < 105
    given = seen(plates(5), 0.7) * valid[..., None]
    noise = np.full(SIZE, 1e-6, np.float32)
    found = lens_blur(given, noise, valid)
    whole = found.variance(given, noise, valid, WHOLE)
    np.testing.assert_array_equal(found.variance(given, noise, valid, rows), whole[rows])
    assert not whole[~valid].any()
    samples = np.random.default_rng(6).integers(0, 9, (SIZE[0], 6, SIZE[1])).astype(np.uint8)
    reflected = reflected_variance(samples, valid, WHOLE)
    np.testing.assert_array_equal(reflected_variance(samples, valid, rows), reflected[rows])


def test_the_border_of_the_object_is_no_edge():
    valid = np.hypot(*(np.indices(SIZE) - 120.0)) < 105
    plane = np.tile(np.float32([0.6, 0, 0.8]), (*SIZE, 1))
    found = LensBlur(1.0, 1.5, True).variance(
        plane * valid[..., None], np.zeros(SIZE, np.float32), valid, WHOLE
    )
    assert found.max() < 1e-9


@pytest.mark.parametrize("half_deg", [30, 60, 90])
def test_a_hollow_sphere_reflects_as_much_as_is_stated(half_deg):
    """All points of a sphere get the same light from any other; a cap has 1 - cos of it."""
    half = np.radians(half_deg)
    polar = np.linspace(0, half, 20_001)
    away = 0.5 * np.sin(half) ** 2 / 4 * np.sin(polar)
    rms = np.sqrt(np.trapezoid(away**2 * np.sin(polar), polar) / (1 - np.cos(half)))
    samples = np.zeros((9, 6, 9), np.uint8)
    samples[:, SampleKind.CAST] = round(100 * (1 - np.cos(half)) / 2)
    samples[:, SampleKind.LIT] = 100 - samples[0, SampleKind.CAST, 0]
    stated = np.sqrt(reflected_variance(samples, np.ones((9, 9), bool), slice(0, 9)))
    assert stated.std() == pytest.approx(0, abs=1e-6)
    assert 0.75 < rms / stated[4, 4] < 1.25


def test_a_common_error_is_in_both_deviations():
    normals, mask = half_ball(30, 0.9)
    lights = Lights(dome(12, 0.97, 0.4))
    values = 0.5 * np.clip(np.einsum("nc,hwc->nhw", lights.unit_directions, normals), 0, None)
    stereo, noise = (
        photometric_stereo(values, lights, mask),
        StackNoise.of_one_exposure(1e-4, 1e-7, 12),
    )
    alone = normal_uncertainty(values, lights, mask, stereo, noise=noise)
    both = normal_uncertainty(values, lights, mask, stereo, noise=noise, common_deg=2.0)
    np.testing.assert_allclose(both.sigma_deg, np.hypot(alone.sigma_deg, 2), rtol=1e-5)
    np.testing.assert_allclose(both.common_sigma_deg[alone.valid], 2, rtol=1e-5)
    with pytest.raises(DataError, match="give 0 or more"):
        normal_uncertainty(values, lights, mask, stereo, common_deg=-1)
    maps = {
        "normals": normals,
        "normal_sigma_deg": alone.sigma_deg,
        "normal_sigma_common_deg": alone.common_sigma_deg,
    }
    assert with_common_error(maps, 0) == maps
    more = with_common_error(maps, 2.0)
    for name, values in (("sigma", both.sigma_deg), ("sigma_common", both.common_sigma_deg)):
        np.testing.assert_allclose(more[f"normal_{name}_deg"][:], values, rtol=1e-5)
    assert np.nanmax(with_common_error(maps, 500.0)["normal_sigma_deg"][:]) == np.float32(
        UNIFORM_DEG
    )


def test_errors_of_the_model_go_where_normals_contradict_each_other():
    """A surface has no curl; a quarter of the map has normals that no surface has."""
    valid = np.hypot(*(np.indices(SIZE) - 120.0)) < 105
    y, x = np.indices(SIZE)
    turned = 0.2 * np.sin(x / 9 + y / 5) * ((x < 120) & (y < 120))
    slopes = np.dstack([0.1 * np.cos(x / 20), turned, 1 + 0 * turned])
    given = (unit(slopes) * valid[..., None]).astype(np.float32)
    found = Inconsistency.of(given, valid)
    factor = found.factor(given, valid, WHOLE)
    assert factor[valid].mean() == pytest.approx(1, rel=1e-4)
    doubtful = valid & (turned != 0)
    assert np.median(factor[doubtful]) > 3 * np.median(factor[valid & ~doubtful])
    surface = unit(np.dstack([0.1 * np.cos(x / 20), 0 * turned, 1 + 0 * turned]))
    assert Inconsistency.of(surface.astype(np.float32), valid).curl < 1e-6
    for rows in (slice(0, 1), slice(33, 34), slice(100, 171)):
        np.testing.assert_array_equal(found.factor(given, valid, rows), factor[rows])
