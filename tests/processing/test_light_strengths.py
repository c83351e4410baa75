"""Strengths of lights from objects of unknown shape, with their standard deviations."""

from __future__ import annotations

import numpy as np
import pytest

from acquisition import DataError, Lights
from calibration import EstimateError
from processing import angular_error, photometric_stereo
from processing.series import light_strengths
from processing.series.strength_fit import solve_normals, strength_information
from tests.processing.scenes import dome, half_ball

SIZE = 40


NORMALS, MASK = half_ball(SIZE)
FLAT = np.zeros_like(NORMALS) + np.array([0.1, 0.2, np.sqrt(0.95)])


def strengths(count: int, rng: np.random.Generator, spread: float = 0.5) -> np.ndarray:
    logarithms = rng.normal(0, spread, count)
    return np.exp(logarithms - logarithms.mean())


def seen(
    vectors: np.ndarray,
    factors: np.ndarray,
    rng: np.random.Generator,
    normals: np.ndarray = NORMALS,
) -> np.ndarray:
    """Return images with the noise of a sensor of 10,000 electrons."""
    albedo = 0.4 * np.exp(0.3 * rng.normal(size=MASK.shape))
    cosine = np.clip(np.sum(np.broadcast_to(vectors, (*MASK.shape, *vectors.shape[-2:]))
                            * normals[..., None, :], axis=-1), 0, None)  # fmt: skip
    images = (albedo[..., None] * cosine * factors).transpose(2, 0, 1)
    images /= images.max()
    return (images + rng.normal(size=images.shape) * np.sqrt(1e-4 * images)).astype(np.float32)


def test_a_surface_that_is_not_matte_is_named() -> None:
    rng = np.random.default_rng(7)
    lights = Lights(directions=dome(24, 0.95, 0.4))
    matte = seen(lights.unit_directions, np.ones(24), rng)
    halves = lights.unit_directions + np.array([0, 0, 1])
    halves /= np.linalg.norm(halves, axis=1, keepdims=True)
    shine = np.clip(np.einsum("hwc,nc->nhw", NORMALS, halves), 0, None) ** 20
    assert light_strengths(matte, lights, MASK).warnings == ()
    glossy = light_strengths((matte + 0.2 * shine).astype(np.float32), lights, MASK)
    assert "strengths-not-matte" in [notice.code for notice in glossy.warnings]


@pytest.mark.slow
@pytest.mark.parametrize(
    "count", [8, pytest.param(12, marks=pytest.mark.slow), pytest.param(36, marks=pytest.mark.slow)]
)
def test_errors_agree_with_the_standard_deviations(count: int) -> None:
    ratios = []
    for seed in range(8):
        rng = np.random.default_rng([seed, count])
        factors, lights = strengths(count, rng), Lights(directions=dome(count, 0.95, 0.4))
        found = light_strengths(seen(lights.unit_directions, factors, rng), lights, MASK)
        ratios.append(np.log(found.factors / factors) / found.sigmas)
        assert np.exp(np.log(found.factors).mean()) == pytest.approx(1)
        np.testing.assert_allclose(found.lights.intensities[:, 0], found.factors)
        np.testing.assert_allclose(
            found.lights.errors.intensity_std[:, 1], found.factors * found.sigmas
        )
    assert 0.7 < np.sqrt(np.mean(np.square(ratios))) < 1.3


def test_given_intensities_are_multiplied_and_the_normals_follow() -> None:
    rng = np.random.default_rng(3)
    factors = strengths(12, rng)
    lights = Lights(directions=dome(12, 0.95, 0.4), intensities=np.linspace(1, 3, 12))
    values = seen(lights.unit_directions, factors, rng)
    found = light_strengths(values, lights, MASK)
    np.testing.assert_allclose(
        found.lights.intensities[:, 0] / lights.intensities[:, 0], found.factors
    )
    errors = []
    for divisor in (factors, found.factors):
        divided = values / divisor[:, None, None].astype(np.float32)
        normal_map = photometric_stereo(divided, lights, MASK).normal_map
        errors.append(angular_error(normal_map, NORMALS.astype(np.float32), MASK).mae_deg)
    assert errors[1] < errors[0] + 0.05


def test_strengths_of_near_lights() -> None:
    rng = np.random.default_rng(4)
    lights = Lights(positions_mm=200 * dome(16, 0.95, 0.4), mu=np.ones(16))
    y, x = np.mgrid[40 : -40 : SIZE * 1j, -40 : 40 : SIZE * 1j]
    points = np.dstack([x, y, 0 * x])
    factors = strengths(16, rng, 0.3)
    vectors = lights.vectors_at(points).transpose(1, 2, 0, 3)
    found = light_strengths(seen(vectors, factors, rng), lights, MASK, points_mm=points)
    assert np.abs(np.log(found.factors / factors)).max() < 0.015


def test_highlights_and_a_moved_light_change_the_others_little() -> None:
    rng = np.random.default_rng(5)
    factors, lights = strengths(24, rng), Lights(directions=dome(24, 0.95, 0.4))
    values = seen(lights.unit_directions, factors, rng)
    half = lights.unit_directions + np.array([0, 0, 1])
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    values += 0.5 * factors[:, None, None] * np.einsum("hwc,nc->nhw", NORMALS, half) ** 60
    values[3] = values[3, ::-1]
    found = light_strengths(values.astype(np.float32), lights, MASK)
    off = np.delete(np.log(found.factors / factors), 3)
    assert np.abs(off - off.mean()).max() < 0.03


RING = np.stack([np.cos(np.arange(9) * 0.7), np.sin(np.arange(9) * 0.7), np.ones(9)], 1)
ROW = np.stack([np.linspace(-1, 1, 7), np.zeros(7), np.ones(7)], 1)
REFUSED = {
    "three lights": (RING[:3], NORMALS, "fewer than 4"),
    "a row and one light": (np.vstack([ROW, [[0, 1, 1]]]), NORMALS, "without L07"),
    "a row": (ROW, NORMALS, "in one plane"),
    "a plane": (dome(12, 0.95, 0.4), FLAT, "too flat"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_strengths_that_the_images_do_not_show_are_refused(name: str) -> None:
    directions, normals, reason = REFUSED[name]
    lights = Lights(directions=directions)
    rng = np.random.default_rng(6)
    values = seen(lights.unit_directions, strengths(len(lights), rng), rng, normals)
    with pytest.raises(EstimateError, match=reason):
        light_strengths(values, lights, MASK)


def test_a_ring_of_lights_is_determined() -> None:
    rng = np.random.default_rng(7)
    lights = Lights(directions=RING)
    factors = strengths(9, rng)
    found = light_strengths(seen(lights.unit_directions, factors, rng), lights, MASK)
    assert np.abs(np.log(found.factors / factors)).max() < 0.02


def test_wrong_inputs_are_named() -> None:
    lights = Lights(directions=RING)
    values = np.ones((9, SIZE, SIZE), np.float32)
    with pytest.raises(DataError, match="8 images for 9 lights"):
        light_strengths(values[:8], lights, MASK)
    with pytest.raises(DataError, match="mask is empty"):
        light_strengths(values, lights, MASK & False)
    with pytest.raises(DataError, match="do not fit a mask"):
        light_strengths(values[:, :9], lights, MASK)
    with pytest.raises(DataError, match="surface points"):
        light_strengths(values, Lights(positions_mm=300 * RING), MASK)
    with pytest.raises(EstimateError, match="too few pixels"):
        light_strengths(np.zeros_like(values), lights, MASK)


def test_pixels_under_one_light_leave_the_information_finite() -> None:
    """Rounding makes eigenvalues of their inverse matrices negative."""
    rng = np.random.default_rng(0)
    vectors = rng.normal(size=(1, 6, 3))
    vectors /= np.linalg.norm(vectors, axis=2, keepdims=True)
    weights = np.eye(6)[rng.integers(0, 6, 500)] + 1e-9 * rng.random((500, 6))
    _, inverse = solve_normals(np.ones((500, 6)), weights, vectors)
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(inverse)
    found = strength_information(weights, np.ones((500, 6)), vectors, inverse)
    assert np.isfinite(found).all()
