"""Intensities from a matte plane: inversion of the closed form, and defects of a real card."""

import numpy as np
import pytest

from acquisition import DataError, Lights
from calibration import EstimateError, MatteSurface, calibrate_intensities
from tests.quick_sample import quick

SIZE = (60, 80)


def card(seed: int, mu: float):
    """Return lights, points of the card, noiseless inverse-square images, and the truth."""
    random = np.random.default_rng(seed)
    around = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    polar = np.radians(np.tile([20, 45, 60], 4))
    ring = [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)]
    positions = 450 * np.stack(ring, axis=1)
    x, y = np.meshgrid(np.linspace(-120, 120, SIZE[1]), np.linspace(90, -90, SIZE[0]))
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    strength = random.uniform(0.5, 2.0, 12)
    albedo = random.uniform(0.2, 0.8, SIZE)
    toward = positions[:, None, None] - points
    distance = np.linalg.norm(toward, axis=-1)
    axis = -positions / np.linalg.norm(positions, axis=1)[:, None]
    cosine = -np.einsum("nhwk,nk->nhw", toward, axis) / distance
    irradiance = 450**2 / distance**2 * cosine**mu * toward[..., 2] / distance
    values = strength[:, None, None] * albedo * irradiance
    return Lights(positions_mm=positions), points, values, strength / strength.mean()


def calibrate(values, lights, points, mask=None):
    mask = np.ones(SIZE, np.bool_) if mask is None else mask
    return calibrate_intensities(MatteSurface(values.astype(np.float32), points, mask), lights)


@pytest.mark.parametrize("mu", [0.0, 1.0, 2.5])
def test_noiseless_images_give_the_true_intensities(mu):
    lights, points, values, strength = card(1, mu)
    result = calibrate(values, lights, points)
    np.testing.assert_allclose(result.lights.intensities[:, 0], strength, rtol=1e-4)
    np.testing.assert_allclose(result.lights.intensities.mean(), 1.0)
    assert abs(result.mu - mu) < 1e-3
    assert result.residual < 1e-4
    assert result.warnings == ()


def test_noise_shadows_highlights_and_saturation_have_little_effect():
    lights, points, values, strength = card(2, 1.0)
    random = np.random.default_rng(3)
    values = values * random.normal(1, 0.01, values.shape)
    values[:, 10:25, 10:25] = random.uniform(0.01, 3, (12, 15, 15))  # a mirror ball on the card
    values[4, :, 60:] *= 0.2  # a shadow
    values[7, :20] = np.nan
    result = calibrate(values, lights, points)
    np.testing.assert_allclose(result.lights.intensities[:, 0], strength, rtol=5e-3)
    assert abs(result.mu - 1.0) < 0.05


def test_a_surface_that_is_not_a_plane_is_reported():
    lights, points, values, _ = card(4, 1.0)
    bumpy = values * np.random.default_rng(5).uniform(0.7, 1.3, values.shape)
    result = calibrate(bumpy, lights, points)
    assert "matte" in str(result.warnings[0])


@pytest.mark.parametrize(
    ("places", "named"),
    quick(
        [
            pytest.param({}, [], id="right"),
            pytest.param({3: 7, 7: 3}, ["L03", "L07"], id="two lights are swapped"),
            pytest.param({3: 4, 4: 3}, ["L03", "L04"], id="neighbours are swapped"),
            pytest.param({5: 6}, ["L05"], id="one is at the place of another one"),
        ],
        every=2,
    ),
)
def test_a_light_at_a_wrong_place_is_named(places, named):
    """Its own axis and falloff absorb the difference, so that the images fit nevertheless."""
    lights, points, values, _ = card(9, 1.0)
    values = values * np.random.default_rng(10).normal(1, 0.01, values.shape)
    wrong = lights.positions_mm.copy()
    for light, place in places.items():
        wrong[light] = lights.positions_mm[place]
    result = calibrate(values, Lights(positions_mm=wrong), points)
    texts = [one.text for one in result.warnings if one.code == "axis-unlike"]
    assert len(texts) == bool(named)
    assert [name for name in lights.ids if any(f"{name} (" in text for text in texts)] == named


def test_pixels_without_a_point_do_not_count():
    lights, points, values, strength = card(7, 1.0)
    points[3:9, 4:20] = np.nan
    result = calibrate(values, lights, points)
    np.testing.assert_allclose(result.lights.intensities[:, 0], strength, rtol=1e-4)
    assert result.pixels == np.prod(SIZE) - 6 * 16


def test_a_light_that_cannot_reach_the_plane_is_named():
    lights, points, values, _ = card(8, 1.0)
    below = lights.positions_mm.copy()
    below[5, 2] = -5.0
    with pytest.raises(EstimateError, match="light L05 cannot reach the lit pixels"):
        calibrate(values, Lights(positions_mm=below), points)


def test_refusals():
    lights, points, values, _ = card(6, 1.0)
    few = np.zeros(SIZE, np.bool_)
    few[:3, :3] = True
    with pytest.raises(DataError, match="positions"):
        calibrate(values, lights.distant(), points)
    with pytest.raises(DataError, match="5 images of a card for 12 lights"):
        calibrate(values[:5], lights, points)
    with pytest.raises(DataError, match="match each other"):
        calibrate(values[:, :5], lights, points)
    with pytest.raises(DataError, match="at least 2 lights"):
        calibrate(values[:1], lights.take([0]), points)
    with pytest.raises(EstimateError, match="0 pixels"):
        calibrate(values * np.nan, lights, points)
    with pytest.raises(EstimateError, match="9 pixels"):
        calibrate(values, lights, points, few)
