"""Weights from the law of the noise, against the Cramer-Rao bound of plain noise."""

import dataclasses

import numpy as np
import pytest

from acquisition import DataError, Lights, angle_deg
from calibration import StackNoise
from processing import photometric_stereo
from processing.stereo import METHODS
from simulator import bench_sensor
from simulator.rendering import Measurement, cramer_rao_deg
from tests.processing.scenes import dome

SLOPE, FLOOR = 1e-4, 2.5e-7


def _lights(count):
    return Lights(dome(count, 0.97, 0.7))


def _cap(size, widest_deg):
    """Return the normals of a spherical cap that fills the frame."""
    y, x = np.mgrid[1 : -1 : size * 1j, -1 : 1 : size * 1j] * np.sin(np.radians(widest_deg)) * 0.7
    return np.stack([x, y, np.sqrt(1 - x * x - y * y)], axis=-1)


def _rms(degrees):
    return np.sqrt(np.mean(np.square(degrees)))


def _bound_deg(normals, albedo, lights, variance):
    """Return the bound from the definition: the inverse Fisher information in the tangent plane."""
    vectors = lights.unit_directions
    information = np.einsum("nhw,ni,nj->hwij", 1 / variance, vectors, vectors)
    inverse = np.linalg.inv(information)
    along = np.einsum("hwi,hwij,hwj->hw", normals, inverse, normals)
    return np.degrees(np.sqrt(np.trace(inverse, axis1=2, axis2=3) - along) / albedo)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("count", "albedo", "highest"),
    [
        pytest.param(36, 0.8, 1.03, id="36-bright"),
        pytest.param(36, 0.08, 1.03, id="36-dark"),
        pytest.param(12, 0.8, 1.05, id="12-bright"),
        pytest.param(8, 0.8, 1.05, id="8-bright"),
    ],
)
def test_every_method_reaches_the_bound(method, count, albedo, highest):
    normals, lights = _cap(48, 45), _lights(count)
    signal = albedo * np.einsum("hwc,nc->nhw", normals, lights.unit_directions)
    assert signal.min() > 0
    variance = FLOOR + SLOPE * signal
    values = signal + np.random.default_rng(31).normal(size=signal.shape) * np.sqrt(variance)
    result = photometric_stereo(
        values,
        lights,
        np.ones(normals.shape[:2], bool),
        method=method,
        noise=StackNoise.of_one_exposure(SLOPE, FLOOR, count),
    )
    error = _rms(angle_deg(result.normal_map.normals, normals))
    assert 0.9 < error / _rms(_bound_deg(normals, albedo, lights, variance)) < highest


def test_the_bound_is_that_of_the_simulator():
    normals, lights = _cap(6, 45), _lights(9)
    sensor = dataclasses.replace(bench_sensor(), read_noise_e=0.0)
    electrons = 4000.0
    measured = Measurement(sensor, electrons / 1000 / sensor.quantum_efficiency, (1000.0,))
    albedo = np.full(normals.shape[:2], 0.5)
    simulated = cramer_rao_deg(normals, albedo, lights, measured)
    signal = 0.5 * np.einsum("hwc,nc->nhw", normals, lights.unit_directions)
    expected = _bound_deg(normals, 0.5, lights, signal / electrons)
    np.testing.assert_allclose(simulated, expected, rtol=0.05)


@pytest.mark.parametrize("method", METHODS)
def test_shadows_and_highlights_in_known_noise_change_nothing_for_the_worse(method):
    normals, lights = _cap(32, 45), _lights(36)
    signal = 0.6 * np.einsum("hwc,nc->nhw", normals, lights.unit_directions)
    rng = np.random.default_rng(8)
    struck = rng.uniform(size=signal.shape).argsort(axis=0) < 8
    values = np.where(struck, rng.choice([0.0, 1.5], size=signal.shape), signal)
    values += rng.normal(size=signal.shape) * np.sqrt(FLOOR + SLOPE * values)
    mask = np.ones(normals.shape[:2], bool)
    known = StackNoise.of_one_exposure(SLOPE, FLOOR, 36)
    plain, weighted = (
        _rms(
            angle_deg(
                photometric_stereo(
                    values, lights, mask, method=method, noise=noise
                ).normal_map.normals,
                normals,
            )
        )
        for noise in (None, known)
    )
    assert weighted <= 1.02 * plain


def test_merged_brackets_mosaics_and_flats_have_a_law_for_each_pixel():
    normals, lights = _cap(40, 45), _lights(12)
    signal = 0.8 * np.einsum("hwc,nc->nhw", normals, lights.unit_directions)
    one = StackNoise.of_one_exposure(SLOPE, FLOOR, 12)
    # The second bracket is 4 times as long, and saturated above half of the signal.
    used = np.where(signal < 0.5, 3, 1).astype(np.uint8)
    merged = dataclasses.replace(
        one,
        slope=np.tile([SLOPE, SLOPE / 4], (12, 1)),
        floor=np.tile([FLOOR, FLOOR / 16], (12, 1)),
        limit=np.tile([np.inf, 0.5], (12, 1)),
        used=used,
    )
    mosaic = dataclasses.replace(
        one, pattern="RGGB", intensities=np.tile([0.25, 1.0, 0.5], (12, 1))
    )
    flat = dataclasses.replace(
        one, response=np.linspace(0.4, 1.0, 1600).reshape(40, 40).astype(np.float32)
    )
    for noise in (merged, mosaic, flat):
        variance = np.stack([noise.variance(i, image) for i, image in enumerate(signal)])
        assert np.ptp(variance / (FLOOR + SLOPE * signal)) > 0.5
        values = signal + np.random.default_rng(3).normal(size=signal.shape) * np.sqrt(variance)
        mask = np.ones(normals.shape[:2], bool)
        mask[3, :7] = False
        result = photometric_stereo(values, lights, mask, method="ls", noise=noise)
        error = angle_deg(result.normal_map.normals, normals)[mask]
        assert _rms(error) < 1.03 * _rms(_bound_deg(normals, 0.8, lights, variance)[mask])


def test_a_law_of_other_images_is_refused():
    values, mask = np.ones((5, 4, 4)), np.ones((4, 4), bool)
    noise = StackNoise.of_one_exposure(SLOPE, FLOOR, 4)
    with pytest.raises(DataError, match="noise of 4 images does not fit 5 images"):
        photometric_stereo(values, _lights(5), mask, noise=noise)
