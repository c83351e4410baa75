"""The estimator `best` on materials and shadows whose normals are known."""

import numpy as np
import pytest

from acquisition import Lights, angle_deg
from calibration import StackNoise
from processing import photometric_stereo
from simulator.scene import Ggx
from simulator.scene.reflectance import reflectance
from tests.processing.scenes import dome, half_ball, one_thread


def _errors(values, directions, normals, mask, *methods, **options):
    """Return the mean angular error of each method, degrees."""
    return [
        angle_deg(
            photometric_stereo(
                values, Lights(directions), mask, method=method, **options
            ).normal_map.normals[mask],
            normals[mask],
        ).mean()
        for method in methods
    ]


def _noisy(values, seed):
    return values + np.random.default_rng(seed).normal(0, 2e-3, values.shape) * values.max()


def _translucent(cosine, wrap):
    return np.clip((cosine + wrap) / (1 + wrap), 0, None)


def _one_side_dark(cosine, directions):
    """Return the shading if a wall hides the half of the lights on one side of each pixel."""
    turn = np.random.default_rng(2).uniform(0, 2 * np.pi, cosine.shape[1:])
    side = np.einsum("nc,chw->nhw", directions[:, :2], np.stack([np.cos(turn), np.sin(turn)]))
    return np.where(side > np.median(side, axis=0), np.clip(cosine, 0, None), 0)


@pytest.mark.parametrize(
    ("material", "share"),
    [
        pytest.param(Ggx(0.5, 0.6), 0.6, id="rough metal"),
        pytest.param(Ggx(0.25, 0.6), 0.6, id="metal"),
        pytest.param(Ggx(0.15, 0.04), 0.8, id="dark gloss"),
        pytest.param(Ggx(0.3, 0.04), 0.7, id="gloss"),
    ],
)
def test_a_glossy_ball_is_better_than_with_the_other_methods(material, share):
    normals, mask = half_ball(33)
    directions = dome(36)
    albedo = 0.0 if material.f0 > 0.5 else 0.2
    cosine = np.einsum("nc,hwc->nhw", directions, normals)
    values = np.clip(cosine, 0, None) * reflectance(
        material, albedo, normals, directions[:, None, None], np.array([0.0, 0, 1])
    )
    ls, cauchy, best = _errors(
        _noisy(values, 21), directions, normals, mask, "ls", "cauchy", "best"
    )
    assert best < share * min(ls, cauchy)


@pytest.mark.parametrize("wrap", [0.3, 0.6])
def test_a_translucent_ball_is_not_worse_than_with_the_other_methods(wrap):
    normals, mask = half_ball(33)
    directions = dome(36)
    values = _translucent(np.einsum("nc,hwc->nhw", directions, normals), wrap)
    ls, cauchy, best = _errors(
        _noisy(values, 22), directions, normals, mask, "ls", "cauchy", "best"
    )
    assert best < min(ls, cauchy) + 1


@pytest.mark.parametrize("near", [False, True], ids=["distant", "near"])
def test_half_of_the_lights_in_cast_shadow(near):
    normals, mask = half_ball(33)
    mask &= normals[..., 2] > 0.5
    directions = dome(36)
    cosine = np.einsum("nc,hwc->nhw", directions, normals)
    values = _noisy(_one_side_dark(cosine, directions), 23)
    if near:
        # Lights so far away that the object has one point: the vectors are per pixel.
        lights = Lights(positions_mm=1e6 * directions, mu=np.zeros(36))
        result = photometric_stereo(
            values, lights, mask, method="best", points_mm=np.zeros((*mask.shape, 3))
        )
        best = angle_deg(result.normal_map.normals[mask], normals[mask]).mean()
    else:
        cauchy, best = _errors(values, directions, normals, mask, "cauchy", "best")
        assert cauchy > 10
    assert best < 1


def test_exact_data_of_the_model_gives_exact_normals_and_albedo():
    normals, mask = half_ball(33)
    mask &= normals[..., 2] > 0.5
    directions = dome(24, lowest=0.6)
    half = directions + np.array([0.0, 0, 1])
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    lobe = np.einsum("nc,hwc->nhw", half, normals) ** 2
    shading = np.clip(np.einsum("nc,hwc->nhw", directions, normals), 0, None)
    result = photometric_stereo(
        shading * (0.3 + 0.4 * lobe), Lights(directions), mask, method="best"
    )
    assert angle_deg(result.normal_map.normals[mask], normals[mask]).max() < 0.02
    matte = photometric_stereo(0.5 * shading, Lights(directions), mask, method="best")
    assert angle_deg(matte.normal_map.normals[mask], normals[mask]).max() < 1e-3
    np.testing.assert_allclose(matte.albedo[mask], 0.5, rtol=1e-5)


@pytest.mark.parametrize("count", [3, 4, 6, 11])
def test_few_lights_are_solved_as_by_cauchy(count):
    normals, mask = half_ball(33)
    mask &= normals[..., 2] > 0.6
    directions = dome(count)
    values = _noisy(np.clip(np.einsum("nc,hwc->nhw", directions, normals), 0, None), 24)
    cauchy, best = (
        photometric_stereo(values, Lights(directions), mask, method=method).normal_map.normals
        for method in ("cauchy", "best")
    )
    np.testing.assert_array_equal(cauchy, best)


@pytest.mark.parametrize("count", [12, 16, 24])
def test_a_dozen_lights_or_two_are_not_worse_than_with_cauchy(count):
    normals, mask = half_ball(33)
    directions = dome(count)
    values = np.clip(np.einsum("nc,hwc->nhw", directions, normals), 0, None) * reflectance(
        Ggx(0.3, 0.04), 0.3, normals, directions[:, None, None], np.array([0.0, 0, 1])
    )
    cauchy, best = _errors(_noisy(values, 25), directions, normals, mask, "cauchy", "best")
    assert best < 1.05 * cauchy


def test_normals_turn_with_the_scene_about_the_optical_axis():
    rng = np.random.default_rng(26)
    directions = dome(20)
    values = rng.uniform(0, 1, (20, 8, 8))
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    mask = np.ones((8, 8), bool)
    first = photometric_stereo(values, Lights(directions), mask, method="best")
    second = photometric_stereo(8 * values, Lights(directions @ turn.T), mask, method="best")
    turned = first.normal_map.normals @ turn.T
    # Rounding may choose another candidate, or end the iteration one step earlier.
    assert np.median(angle_deg(second.normal_map.normals, turned)) < 0.01
    assert np.mean(angle_deg(second.normal_map.normals, turned) < 0.1) > 0.9


def test_results_do_not_depend_on_blocks_threads_or_neighbours():
    rng = np.random.default_rng(27)
    values = rng.uniform(0, 1, (18, 40, 31)).astype(np.float32)
    values[rng.uniform(size=values.shape) < 0.05] = np.nan
    lights, mask = Lights(dome(18)), np.ones((40, 31), bool)
    # Without a law, one would be estimated from all pixels.
    noise = StackNoise.of_one_exposure(1e-4, 1e-6, 18)
    whole = photometric_stereo(values, lights, mask, method="best", noise=noise)
    with one_thread():
        part = photometric_stereo(values[:, 7:9], lights, mask[7:9], method="best", noise=noise)
    np.testing.assert_array_equal(part.normal_map.normals, whole.normal_map.normals[7:9])


@pytest.mark.parametrize(
    "fill",
    [
        pytest.param(0.0, id="all but two black"),
        pytest.param(-1e-3, id="all but two negative"),
        pytest.param(1.0, id="constant"),
    ],
)
def test_samples_without_a_sensible_normal_terminate(fill):
    values = np.full((20, 3, 3), fill)
    values[:2] = 1.0
    values[:, 0, 0] = np.random.default_rng(28).uniform(size=20)
    result = photometric_stereo(values, Lights(dome(20)), np.ones((3, 3), bool), method="best")
    assert np.isfinite(result.normal_map.normals).all()
    assert np.isfinite(result.albedo).all()
