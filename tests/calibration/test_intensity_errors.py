"""Strengths of lights over many seeds: errors against standard deviations, closed forms."""

from dataclasses import dataclass

import numpy as np
import pytest

from acquisition import CameraModel, DataError, LightErrors, Lights, angle_deg
from acquisition.values import tangent_basis
from calibration import EstimateError, MatteSurface, calibrate_intensities

CAMERA = CameraModel(np.array([[65.0, 0, 15.5], [0, 65.0, 11.5], [0, 0, 1]]), 32, 24, 600)
SEEDS = 50


@dataclass
class Truth:
    positions: np.ndarray
    axes: np.ndarray
    mu: np.ndarray
    intensities: np.ndarray

    def irradiance(self, points, normals=(0.0, 0.0, 1.0)):
        """Return the irradiance, 1 at the origin for a facing surface: ``(K, H, W)``."""
        toward = self.positions[:, None, None] - points
        distance = np.linalg.norm(toward, axis=-1)
        home = np.linalg.norm(self.positions, axis=1)
        cosine = -np.einsum("khwi,ki->khw", toward, self.axes) / distance
        cosine_home = -np.sum(self.positions * self.axes, axis=1) / home
        facing = np.clip(np.sum(toward * np.asarray(normals), axis=-1) / distance, 0, None)
        pattern = (cosine / cosine_home[:, None, None]) ** self.mu[:, None, None]
        return (home[:, None, None] / distance) ** 2 * facing * pattern


def truth_of(random, *, channels=1, tilt_deg=2.0, mu_spread=0.06, count=8):
    around = 2 * np.pi * np.arange(count) / count
    polar = np.radians(np.resize([20, 40, 55], count))
    ring = [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)]
    positions = 450 * np.stack(ring, axis=1) + random.normal(0, 4, (count, 3))
    axes = -positions / np.linalg.norm(positions, axis=1)[:, None]
    tilts = random.normal(0, np.radians(tilt_deg), (count, 2))
    axes = axes + np.einsum("kj,kji->ki", tilts, tangent_basis(axes))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    intensities = random.uniform(0.6, 1.6, (count, channels))
    mu = random.normal(1.2, mu_spread, count)
    return Truth(positions, axes, mu, intensities / intensities.mean(axis=0))


def images(random, truth, points, normals=(0.0, 0.0, 1.0), noise=0.003):
    """Return images of a card with a random pattern and shot noise, ``(K, H, W[, 3])``."""
    channels = truth.intensities.shape[1]
    albedo = random.uniform(0.2, 0.8, (*points.shape[:2], channels))
    values = (
        truth.intensities[:, None, None] * albedo * truth.irradiance(points, normals)[..., None]
    )
    values = values + noise * np.sqrt(0.3 * values) * random.normal(0, 1, values.shape)
    return (values[..., 0] if channels == 1 else values).astype(np.float32)


def scores(truth, found):
    """Return squared errors in standard deviations: of intensities, mu and axes."""
    errors, channels = found.lights.errors, truth.intensities.shape[1]
    off = found.lights.intensities[:, :channels] - truth.intensities
    across = np.einsum("ki,kji->kj", truth.axes, tangent_basis(found.lights.axes))
    return (
        np.mean((off / errors.intensity_std[:, :channels]) ** 2),
        np.mean(((found.lights.mu - truth.mu) / errors.mu_std) ** 2),
        np.mean((across / np.radians(errors.axis_std_deg)[:, None]) ** 2),
    )


@pytest.mark.slow
def test_errors_of_a_card_agree_with_their_standard_deviations():
    """Positions are wrong by .7 mm, and their covariances say so."""
    found = []
    for seed in range(SEEDS):
        random = np.random.default_rng(seed)
        truth = truth_of(random)
        values = images(random, truth, CAMERA.points_on_plane())
        positions = truth.positions + random.normal(0, 0.7, truth.positions.shape)
        known = LightErrors(covariances=np.tile(0.49 * np.eye(3), (8, 1, 1)))
        lights = Lights(positions_mm=positions, errors=known)
        result = calibrate_intensities(MatteSurface.card(values, CAMERA), lights)
        assert result.own_mu.all()
        assert result.own_axis.all()
        assert result.warnings == ()
        np.testing.assert_array_equal(result.lights.errors.covariances, known.covariances)
        found.append(scores(truth, result))
    assert np.all(np.abs(np.mean(found, axis=0) - 1.025) < 0.225), np.mean(found, axis=0)


@pytest.mark.slow
def test_errors_of_colour_and_two_heights_agree_with_their_standard_deviations():
    found, off, mu = [], [], []
    for seed in range(SEEDS):
        random = np.random.default_rng(seed)
        truth = truth_of(random, channels=3)
        cards = []
        for z in (0.0, 25.0):
            values = images(random, truth, CAMERA.points_on_plane(z))
            cards.append(MatteSurface.card(values, CAMERA, z_mm=z))
        result = calibrate_intensities(cards, Lights(positions_mm=truth.positions))
        found.append(scores(truth, result))
        off.append(np.abs(result.lights.intensities / truth.intensities - 1).max())
        mu.append(np.abs(result.lights.mu / truth.mu - 1).max())
    assert np.all(np.abs(np.mean(found, axis=0) - 1.025) < 0.225), np.mean(found, axis=0)
    assert max(off) < 0.003
    assert max(mu) < 0.02


def test_a_matte_ball_gives_the_strengths():
    camera = CameraModel(np.array([[400.0, 0, 31.5], [0, 400, 31.5], [0, 0, 1]]), 64, 64, 600)
    random = np.random.default_rng(1)
    truth = truth_of(random)
    # The cone of rays that touch a ball on the axis: sin = 40 / 560.
    radius = 400 * np.tan(np.arcsin(40 / 560))
    ball = MatteSurface.ball(np.zeros((8, 64, 64), np.float32), camera, (31.5, 31.5, radius), 40)
    middle = ball.points_mm[31:33, 31:33].mean(axis=(0, 1))
    np.testing.assert_allclose(middle, [0, 0, 80], atol=0.1)
    points, normals = np.nan_to_num(ball.points_mm), np.nan_to_num(ball.normals)
    np.testing.assert_allclose(
        ball.points_mm[ball.mask], [0, 0, 40] + 40 * ball.normals[ball.mask], atol=1e-6
    )
    values = images(random, truth, points, normals)
    ball = MatteSurface.ball(values, camera, (31.5, 31.5, radius), 40)
    found = calibrate_intensities(ball, Lights(positions_mm=truth.positions))
    assert np.abs(found.lights.intensities[:, :1] / truth.intensities - 1).max() < 0.02
    assert scores(truth, found)[0] < 3


def test_what_a_small_card_does_not_determine_is_shared():
    """One patch of 5 mm sees each light under one angle."""
    random = np.random.default_rng(2)
    truth = truth_of(random, tilt_deg=0)
    points = CAMERA.points_on_plane() / 50
    found = calibrate_intensities(
        MatteSurface(images(random, truth, points), points, np.ones((24, 32), np.bool_)),
        Lights(positions_mm=truth.positions),
    )
    assert not found.own_mu.any()
    assert not found.own_axis.any()
    assert np.ptp(found.lights.mu) < 1e-12
    towards = -truth.positions
    assert angle_deg(found.lights.axes, towards).max() < 1e-6
    assert found.lights.errors.mu_std.min() > 0.03
    np.testing.assert_allclose(found.lights.intensities[:, :1], truth.intensities, rtol=2e-3)


@pytest.mark.parametrize("off_mm", [5.0, -20.0])
def test_a_card_at_another_height_is_named(off_mm):
    random = np.random.default_rng(3)
    truth = truth_of(random, tilt_deg=0.1)
    values = images(random, truth, CAMERA.points_on_plane(off_mm))
    found = calibrate_intensities(
        MatteSurface.card(values, CAMERA), Lights(positions_mm=truth.positions)
    )
    notice = next(notice for notice in found.warnings if notice.code == "card-off-plane")
    amount = float(notice.text.split("about ")[1].split(" mm")[0])
    assert abs(amount - abs(off_mm)) < 0.25 * abs(off_mm)
    assert ("higher" if off_mm > 0 else "lower") in notice.text


def test_vignetting_needs_an_even_card():
    random = np.random.default_rng(4)
    truth = truth_of(random)
    points = CAMERA.points_on_plane()
    rows, columns = np.mgrid[:24, :32]
    radius = np.hypot(rows - 11.5, columns - 15.5) / 20
    values = truth.intensities[:, None] * truth.irradiance(points) * np.exp(-0.2 * radius**2)
    values *= random.normal(1, 0.003, values.shape)
    card = MatteSurface.card(values.astype(np.float32), CAMERA)
    lights = Lights(positions_mm=truth.positions)
    plain = calibrate_intensities(card, lights)
    assert plain.vignetting is None
    np.testing.assert_allclose(plain.lights.intensities[:, :1], truth.intensities, rtol=3e-3)
    seen = calibrate_intensities(card, lights, even=True).vignetting
    assert abs(seen.corner - np.exp(-0.2)) < 4 * seen.corner_std
    assert seen.corner_std < 0.01


def test_lights_that_were_calibrated_give_the_same_result_again():
    """Estimated axes are no evidence about the axes."""
    random = np.random.default_rng(7)
    truth = truth_of(random)
    card = MatteSurface.card(images(random, truth, CAMERA.points_on_plane()), CAMERA)
    first = calibrate_intensities(card, Lights(positions_mm=truth.positions))
    again = calibrate_intensities(card, first.lights)
    np.testing.assert_array_equal(again.lights.axes, first.lights.axes)
    np.testing.assert_array_equal(
        again.lights.errors.axis_std_deg, first.lights.errors.axis_std_deg
    )


def test_a_glossy_card_is_named():
    random = np.random.default_rng(5)
    truth = truth_of(random)
    points = CAMERA.points_on_plane()
    values = images(random, truth, points)
    half = truth.positions[:, None, None] - points
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    view = CAMERA.centre_mm - points
    half += view / np.linalg.norm(view, axis=-1, keepdims=True)
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    glossy = values + (0.5 * half[..., 2] ** 40).astype(np.float32)
    found = calibrate_intensities(
        MatteSurface.card(glossy, CAMERA), Lights(positions_mm=truth.positions)
    )
    assert "plane-deviates" in [notice.code for notice in found.warnings]


def test_bad_input_is_named():
    random = np.random.default_rng(6)
    truth = truth_of(random, channels=3)
    values = images(random, truth, CAMERA.points_on_plane())
    lights = Lights(positions_mm=truth.positions)

    def calibrate(changed):
        return calibrate_intensities(MatteSurface.card(changed, CAMERA), lights)

    dead = values.copy()
    dead[..., 1] = 0
    with pytest.raises(EstimateError, match="the green channel shows no light"):
        calibrate(dead)
    dark = values.copy()
    dark[3] = 0
    with pytest.raises(EstimateError, match="light L03 lights only 0 unsaturated pixels"):
        calibrate(dark)
    with pytest.raises(DataError, match="not from a camera of 32 x 24 pixels"):
        calibrate(values[:, :10])
    with pytest.raises(EstimateError, match="0 pixels of the plane"):
        calibrate(values * np.nan)
    with pytest.raises(DataError, match="infinite"):
        calibrate(np.where(values > 0.5, np.inf, values).astype(np.float32))
    both = [MatteSurface.card(stack, CAMERA) for stack in (values, values[..., 0])]
    with pytest.raises(DataError, match="gray, of another RGB"):
        calibrate_intensities(both, lights)
    with pytest.raises(DataError, match="not in front of the camera"):
        MatteSurface.card(values, CAMERA, z_mm=700)
    with pytest.raises(DataError, match="radius in mm above 0"):
        MatteSurface.ball(values, CAMERA, (15, 11, -3), 20)
