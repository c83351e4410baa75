"""The law of the noise that neighbouring pixels show."""

import numpy as np
import pytest
from scipy.optimize import nnls

from acquisition import Lights, angle_deg
from processing import photometric_stereo
from processing.stereo.frames import Frames
from processing.stereo.image_noise import _not_negative, law_of_images
from processing.stereo.light_model import LightModel
from tests.processing.scenes import dome, half_ball

COUNT = 24


@pytest.fixture(scope="module")
def scene():
    """Return normals, directions, signal and albedo of a cap without shadows."""
    y, x = np.mgrid[1 : -1 : 60 * 1j, -1 : 1 : 60 * 1j] * 0.4
    normals = np.stack([x, y, np.sqrt(1 - x * x - y * y)], axis=-1)
    directions = dome(COUNT, 0.97, 0.7)
    albedo = 0.5 + 0.3 * np.sin(x * 40)
    return normals, directions, albedo * np.einsum("nc,hwc->nhw", directions, normals), albedo


def _law(values, lights):
    mask = np.ones(values.shape[1:], bool)
    return law_of_images(Frames(values.astype(np.float32)), LightModel(lights, None, mask), mask)


def test_the_law_of_one_sensor_under_lights_of_different_intensity(scene):
    _, directions, signal, _ = scene
    intensities = np.linspace(0.5, 3, COUNT)
    for slope, floor in ((1e-4, 1e-6), (1e-3, 1e-5), (0.0, 1e-4)):
        raw = signal * intensities[:, None, None]
        rng = np.random.default_rng(51)
        raw = raw + rng.normal(size=raw.shape) * np.sqrt(floor + slope * raw)
        values = raw / intensities[:, None, None]
        law = _law(values, Lights(directions, intensities=intensities))
        true = (floor + slope * intensities * 0.5) / intensities**2
        np.testing.assert_allclose((law[0, 0] + law[0, 1] * 0.5) / true, 1, atol=0.25)


def test_few_lights_show_the_law_as_well(scene):
    """The median of the residuals of a robust fit of 6 samples is half of what it is of many."""
    _, directions, signal, _ = scene
    slope, floor = 1e-4, 1e-6
    for count in (5, 6, 7, 8):
        kept = np.linspace(0, COUNT - 1, count).astype(int)
        images = signal[kept]
        rng = np.random.default_rng(53)
        values = images + rng.normal(size=images.shape) * np.sqrt(floor + slope * images)
        law = _law(values, Lights(directions[kept]))
        found = law[0, 0] + law[0, 1] * 0.5
        np.testing.assert_allclose(found / (floor + slope * 0.5), 1, atol=0.25)


def test_the_noise_of_bright_samples_is_not_that_of_dark_ones():
    """Least squares of 6 samples spread it; taken for that of each sample, slopes are .3 to .5."""
    normals, mask = half_ball(100)
    lights = Lights(dome(6))
    images = 0.7 * np.clip(np.tensordot(lights.unit_directions, normals, (1, 2)), 0, None)
    slope, floor = 1e-4, 2.5e-7
    slopes = []
    for seed in range(54, 60):
        rng = np.random.default_rng(seed)
        values = images + rng.normal(size=images.shape) * np.sqrt(floor + slope * images)
        frames = Frames(values.astype(np.float32))
        law = law_of_images(frames, LightModel(lights, None, mask), mask)
        slopes.append(law[0, 1] / slope)
    np.testing.assert_allclose(np.mean(slopes), 1, atol=0.2)


def test_images_that_do_not_show_their_noise_have_no_law(scene):
    _, directions, signal, _ = scene
    lights = Lights(directions)
    assert _law(np.round(signal, 12), lights) is None
    assert _law(signal[:, :3, :5], lights) is None
    assert _law(signal[:4], lights.take([0, 1, 2, 3])) is None
    assert _law(np.full(signal.shape, np.nan), lights) is None
    assert _law(np.zeros(signal.shape), lights) is None


@pytest.mark.parametrize("method", ["trimmed", "cauchy", "best"])
def test_every_robust_method_is_as_exact_as_weighted_least_squares(scene, method):
    normals, directions, signal, albedo = scene
    slope, floor = 1e-4, 2.5e-7
    variance = floor + slope * signal
    values = signal + np.random.default_rng(52).normal(size=signal.shape) * np.sqrt(variance)
    information = np.einsum("nhw,ni,nj->hwij", 1 / variance, directions, directions)
    inverse = np.linalg.inv(information)
    along = np.einsum("hwi,hwij,hwj->hw", normals, inverse, normals)
    bound = np.degrees(np.sqrt(np.trace(inverse, axis1=2, axis2=3) - along) / albedo)
    mask = np.ones(albedo.shape, bool)
    found = photometric_stereo(values, Lights(directions), mask, method=method)
    error = angle_deg(found.normal_map.normals, normals)
    assert np.sqrt(np.mean(error**2)) < 1.04 * np.sqrt(np.mean(bound**2))


def test_two_coefficients_that_are_not_negative_are_those_of_scipy():
    rng = np.random.default_rng(3)
    seen = set()
    for _ in range(100):
        terms = rng.uniform(size=(8, 2))
        values = terms @ rng.normal(size=2) + 0.2 * rng.normal(size=8)
        expected, _ = nnls(terms, values)
        np.testing.assert_allclose(_not_negative(terms, values), expected, atol=1e-12)
        seen.add(tuple(expected > 0))
    assert len(seen) == 4
