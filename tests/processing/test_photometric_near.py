import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import DataError, Lights, angle_deg
from calibration import EstimateError
from processing import photometric_stereo
from processing.stereo import METHODS as METHOD_NAMES

METHODS = pytest.mark.parametrize("method", METHOD_NAMES)


def _ring(count, *, radius_mm=150.0, height_mm=300.0):
    turn = 2 * np.pi * np.arange(count) / count
    radius = np.where(np.arange(count) % 2, radius_mm, 0.5 * radius_mm)
    return np.stack(
        [radius * np.cos(turn), radius * np.sin(turn), np.full(count, height_mm)], axis=1
    )


def _plane(height=40, width=70, *, step_mm=2.0, slope=(0.2, -0.1)):
    """Return points and the normal of a tilted plane through the origin."""
    x, y = np.meshgrid((np.arange(width) - width / 2), -(np.arange(height) - height / 2))
    x, y = x * step_mm, y * step_mm
    normal = np.array([-slope[0], -slope[1], 1.0])
    points = np.stack([x, y, slope[0] * x + slope[1] * y], axis=2)
    return points, normal / np.linalg.norm(normal)


def _irradiance(points, normal, position, axis, mu):
    """Return the LED model for one light, from its definition E = cos^mu / r^2 * n.l."""

    def at(p):
        toward = position - p
        r = np.sqrt((toward**2).sum(axis=-1))
        emitted = np.clip((-toward @ (axis / np.linalg.norm(axis))) / r, 0, None) ** mu / r**2
        return emitted, toward / r[..., None]

    emitted, direction = at(points)
    reference, _ = at(np.zeros((1, 3)))
    return emitted / reference * np.clip(direction @ normal, 0, None)


@METHODS
@pytest.mark.parametrize("mu", [0.0, 1.0, 2.7])
def test_a_plane_under_leds_is_exact(method, mu):
    points, normal = _plane()
    positions = _ring(14)
    axes = -positions + np.random.default_rng(4).normal(scale=40, size=positions.shape)
    values = np.stack(
        [0.7 * _irradiance(points, normal, p, a, mu) for p, a in zip(positions, axes, strict=True)]
    )
    lights = Lights(positions_mm=positions, axes=axes, mu=np.full(14, mu))
    mask = np.ones(points.shape[:2], bool)
    result = photometric_stereo(values, lights, mask, method=method, points_mm=points)
    assert angle_deg(result.normal_map.normals, normal).max() < 1e-4
    np.testing.assert_allclose(result.albedo, 0.7, rtol=1e-5)
    distant = photometric_stereo(values, lights.distant(), mask, method=method)
    assert angle_deg(distant.normal_map.normals, normal).mean() > 3


@METHODS
@pytest.mark.parametrize("pixels", [1, 2, 3, 255, 256, 257, 513])
def test_every_pixel_is_solved_under_its_own_lights(method, pixels):
    """The solvers divide the pixels into blocks."""
    points, normal = _plane(height=1, width=pixels, step_mm=max(60.0 / pixels, 0.5))
    positions = _ring(14)
    axes, mu = -positions, np.ones(14)
    values = np.stack(
        [0.7 * _irradiance(points, normal, p, a, 1.0) for p, a in zip(positions, axes, strict=True)]
    )
    values[0, :, ::3] = np.nan  # also pixels that miss a light
    lights = Lights(positions_mm=positions, axes=axes, mu=mu)
    mask = np.ones((1, pixels), bool)
    result = photometric_stereo(values, lights, mask, method=method, points_mm=points)
    assert result.normal_map.mask.all()
    assert angle_deg(result.normal_map.normals, normal).max() < 1e-4
    np.testing.assert_allclose(result.albedo, 0.7, rtol=1e-5)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=25)
def test_light_vectors_are_those_of_the_lights(seed):
    rng = np.random.default_rng(seed)
    positions = _ring(6, radius_mm=250)[1::2] + rng.normal(size=(3, 3)) * 20
    lights = Lights(
        positions_mm=positions,
        axes=-positions + rng.normal(size=(3, 3)) * 30,
        mu=rng.choice([0.0, 1.0, 3.3], 3),
    )
    points = rng.normal(size=(2, 5, 3)) * 30
    vectors = lights.vectors_at(points)
    values = rng.uniform(0.2, 1, (3, 2, 5)).astype(np.float32)
    result = photometric_stereo(values, lights, np.ones((2, 5), bool), points_mm=points)
    m = result.normal_map.normals * result.albedo[..., None]
    reproduced = np.einsum("nhwi,hwi->nhw", vectors, m)
    # With three lights there is no residual, so every light vector must reproduce its image to
    # float32 rounding.
    has_normal = result.normal_map.mask
    assert has_normal.all()
    assert np.abs(reproduced - values)[:, has_normal].max() < 2e-6 * result.albedo.max()


def test_leds_that_face_away_and_unknown_points_are_left_out():
    points, normal = _plane(4, 6)
    positions = _ring(8)
    values = np.stack([_irradiance(points, normal, p, -p, 1.0) for p in positions])
    points[1, 2] = np.nan
    positions = np.vstack([positions, [500.0, 0.0, 20.0]])
    values = np.concatenate([values, np.full((1, 4, 6), 0.9)])
    axes = -positions
    points[3, 3] = (510.0, 0.0, 20.0)
    mask = np.ones((4, 6), bool)
    result = photometric_stereo(
        values, Lights(positions_mm=positions, axes=axes, mu=np.ones(9)), mask, points_mm=points
    )
    assert result.used[1, 2] == 0
    assert not result.normal_map.mask[1, 2]
    assert result.used[3, 3] == 8
    assert result.used[0, 0] == 9


def test_lights_with_positions_require_points():
    values, mask = np.ones((8, 4, 5)), np.ones((4, 5), bool)
    lights = Lights(positions_mm=_ring(8))
    with pytest.raises(DataError, match="need surface points"):
        photometric_stereo(values, lights, mask)
    with pytest.raises(DataError, match="do not fit a mask"):
        photometric_stereo(values, lights, mask, points_mm=np.zeros((5, 4, 3)))
    with pytest.raises(DataError, match="are not finite"):
        photometric_stereo(values, lights, mask, points_mm=np.full((4, 5, 3), np.nan))


def test_leds_in_a_row_are_refused():
    positions = np.stack([np.linspace(-200, 200, 9), np.zeros(9), np.full(9, 300.0)], axis=1)
    with pytest.raises(EstimateError, match="close to one plane"):
        photometric_stereo(
            np.ones((9, 4, 5)),
            Lights(positions_mm=positions),
            np.ones((4, 5), bool),
            points_mm=np.zeros((4, 5, 3)),
        )
