"""The Cramer-Rao bound against closed forms, and against an estimator that nearly reaches it."""

import dataclasses

import numpy as np
import pytest

from acquisition import DataError, Lights, NoiseModel
from simulator import render, scene_named
from simulator.camera import sensor_image
from simulator.rendering import Measurement, cramer_rao_deg

NOISE = NoiseModel(2.5, 6.0, 64.0, 12)
# One photon per microsecond from a white surface: exposure times equal photons.
MEASUREMENT = Measurement(NOISE, 1.0, (8000.0,))


def variance_e(noise, electrons):
    return electrons + noise.read_noise_e**2 + noise.electrons_per_dn**2 / 12


def bound(normal, lights, *, albedo=0.5, points_mm=None, shadows=None, **measurement):
    return cramer_rao_deg(
        np.asarray(normal, np.float32)[None, None],
        np.full((1, 1), albedo, np.float32),
        lights,
        dataclasses.replace(MEASUREMENT, **measurement),
        points_mm=points_mm,
        shadows=shadows,
    )[0, 0]


def test_three_orthogonal_lights_around_the_normal():
    # Every sample is s = A rho / sqrt(3); F = A^2 / v I; angle^2 = 2 v / (A rho)^2.
    amount, albedo = 8000.0, 0.5
    variance = variance_e(NOISE, amount * albedo / np.sqrt(3))
    expected = np.degrees(np.sqrt(2 * variance) / (amount * albedo))
    result = bound(np.ones(3) / np.sqrt(3), Lights(directions=np.eye(3)), albedo=albedo)
    assert result == pytest.approx(expected, rel=1e-5)


def ring(count, elevation_deg):
    azimuth, rise = 2 * np.pi * np.arange(count) / count, np.radians(elevation_deg)
    return np.stack(
        [
            np.cos(rise) * np.cos(azimuth),
            np.cos(rise) * np.sin(azimuth),
            np.full(count, np.sin(rise)),
        ],
        axis=1,
    )


@pytest.mark.parametrize(
    ("noise", "gain_db", "background"),
    [
        pytest.param(NOISE, 0.0, 0.0, id="plain"),
        pytest.param(dataclasses.replace(NOISE, quantum_efficiency=0.4), 0.0, 0.0, id="qe"),
        pytest.param(dataclasses.replace(NOISE, dark_current_e_per_s=9e4), 0.0, 0.0, id="dark"),
        pytest.param(NOISE, 0.0, 0.1, id="background"),
        pytest.param(dataclasses.replace(NOISE, electrons_per_dn=20.0), 12.0, 0.0, id="gain"),
    ],
)
def test_a_ring_of_lights_over_a_flat_surface(noise, gain_db, background):
    # F = N A^2 / v diag(c^2 / 2, c^2 / 2, s^2); angle^2 = 4 v / (N A^2 c^2 rho^2).
    count, rise, exposure_us, albedo = 12, np.radians(40), 8000.0, 0.3
    scale = exposure_us * noise.quantum_efficiency
    electrons = scale * albedo * np.sin(rise)
    electrons += scale * background + noise.dark_current_e_per_s * exposure_us / 1e6
    per_dn = noise.electrons_per_dn / 10 ** (gain_db / 20)
    variance = electrons + noise.read_noise_e**2 + per_dn**2 / 12
    expected = np.degrees(2 * np.sqrt(variance / count) / (scale * np.cos(rise) * albedo))
    result = bound(
        (0, 0, 1),
        Lights(directions=ring(count, 40)),
        albedo=albedo,
        noise=noise,
        exposures_us=(exposure_us,),
        gain_db=gain_db,
        background_per_us=background,
    )
    assert result == pytest.approx(expected, rel=1e-5)


def test_every_repeat_counts_and_saturated_brackets_do_not():
    lights = Lights(directions=ring(8, 50))
    one = bound((0, 0, 1), lights)
    assert bound((0, 0, 1), lights, exposures_us=(8000.0,) * 4) == pytest.approx(one / 2, rel=1e-6)
    # 0.5 * sin 50 * 30 000 electrons are more than 4031 * 2.5.
    assert bound((0, 0, 1), lights, exposures_us=(8000.0, 30_000.0)) == one
    full = dataclasses.replace(NOISE, full_well_e=3000.0)
    assert bound((0, 0, 1), lights, noise=full) == np.inf


def test_a_near_light_equals_a_distant_one_of_the_same_irradiance():
    """For a point away from the origin, with the explicit law cos^mu / r^2."""
    place = 400 * ring(9, 55) + [[20.0, 0, 0]]
    axes = -ring(9, 55)
    mu = np.linspace(0.6, 1.4, 9)
    intensities = np.linspace(0.8, 1.2, 9)
    lights = Lights(positions_mm=place, axes=axes, mu=mu, intensities=intensities)
    point, normal = np.array([50.0, -30.0, 12.0]), np.array([0.2, 0.1, 1.0])
    normal /= np.linalg.norm(normal)

    def fall_off(at):
        way = at - place
        r = np.linalg.norm(way, axis=1)
        return ((way * axes).sum(axis=1) / r) ** mu / r**2

    toward = place - point
    same = Lights(
        directions=toward, intensities=intensities * fall_off(point) / fall_off(np.zeros(3))
    )
    result = bound(normal, lights, points_mm=point[None, None])
    assert result == pytest.approx(bound(normal, same), rel=1e-5)


def test_mosaic_pixels_see_the_intensity_of_their_channel():
    directions = ring(6, 45)
    colours = np.array([[0.5, 1.0, 0.25]]) * np.ones((6, 1))
    lights = Lights(directions=directions, intensities=colours)
    normals = np.tile(np.float32([0, 0, 1]), (1, 3, 1))
    result = cramer_rao_deg(
        normals,
        # Only the albedo of a pixel's own channel matters.
        np.where(np.eye(3, dtype=bool), 0.5, 0.9)[None],
        lights,
        Measurement(NOISE, np.array([[1.0, 1.0, 2.0]]), (8000.0,), channel=np.array([[0, 1, 2]])),
    )[0]
    alone = [
        bound((0, 0, 1), Lights(directions=directions, intensities=np.full(6, i)))
        for i in (0.5, 1.0, 0.5)
    ]
    np.testing.assert_allclose(result, alone, rtol=1e-6)


def test_a_monochrome_pixel_sees_the_mean_of_intensity_times_albedo():
    directions = ring(6, 45)
    colours = np.linspace(0.4, 1.6, 18).reshape(6, 3)
    albedo = np.array([0.9, 0.3, 0.6])
    result = cramer_rao_deg(
        np.float32([[[0, 0, 1]]]),
        albedo[None, None],
        Lights(directions=directions, intensities=colours),
        MEASUREMENT,
    )[0, 0]
    grey = Lights(directions=directions, intensities=(colours @ albedo) / 3 / 0.6)
    assert result == pytest.approx(bound((0, 0, 1), grey, albedo=0.6), rel=1e-6)


def test_lights_that_do_not_reach_the_point_give_no_information():
    directions = np.vstack([ring(6, 45), [[0.9, 0, -0.1]]])
    few = bound((0, 0, 1), Lights(directions=directions[:5]))
    shadows = np.zeros((7, 1, 1), np.bool_)
    shadows[5] = True
    assert bound((0, 0, 1), Lights(directions=directions), shadows=shadows) == few
    shadows[2:] = True
    assert bound((0, 0, 1), Lights(directions=directions), shadows=shadows) == np.inf


@pytest.mark.parametrize(
    ("directions", "albedo"),
    [
        pytest.param([[1, 0, 1], [-1, 0, 1], [0, 0, 1]], 0.5, id="coplanar lights"),
        pytest.param(np.eye(3), 0.0, id="black"),
    ],
)
def test_the_bound_is_infinite_if_the_normal_is_undetermined(directions, albedo):
    lights = Lights(directions=np.array(directions, float))
    assert bound(np.array([0.1, 0.2, 1]) / np.sqrt(1.05), lights, albedo=albedo) == np.inf


def test_the_bound_is_nan_outside_the_mask():
    assert np.isnan(bound((0, 0, 0), Lights(directions=np.eye(3))))


def estimate(grey, noise, exposure_us, directions):
    """Weighted least squares on every row of (trials, N); weights are from the previous fit."""
    electrons = (grey - noise.black_level_dn) * noise.electrons_per_dn
    design = exposure_us * directions
    weights = np.ones_like(electrons)
    for _ in range(3):
        left = np.einsum("tn,na,nb->tab", weights, design, design)
        right = np.einsum("tn,na,tn->ta", weights, design, electrons)
        m = np.linalg.solve(left, right[..., None])[..., 0]
        weights = 1 / variance_e(noise, np.maximum(m @ design.T, 0))
    return m / np.linalg.norm(m, axis=1, keepdims=True)


@pytest.mark.parametrize(
    ("normal", "albedo", "exposure_us", "count"),
    [
        pytest.param((0, 0, 1), 0.5, 8000.0, 12, id="flat"),
        pytest.param((0.5, -0.3, 0.8), 0.4, 8000.0, 12, id="oblique"),
        pytest.param((0.5, -0.3, 0.8), 0.1, 3000.0, 12, id="dim"),
        pytest.param((0.1, 0.2, 1.0), 0.8, 6000.0, 3, id="three lights"),
    ],
)
def test_an_efficient_estimator_reaches_the_bound(normal, albedo, exposure_us, count):
    trials = 40_000
    normal = np.array(normal) / np.linalg.norm(normal)
    directions = ring(count, 50)
    if count > 3:
        directions[::2] = ring(count, 70)[::2]
    assert (directions @ normal > 0).all()
    photons = albedo * exposure_us * np.tile(directions @ normal, (trials, 1))
    grey = sensor_image(photons.astype(np.float32), NOISE, key=(11,))
    result = estimate(grey.astype(np.float64), NOISE, exposure_us, directions)
    error = np.arctan2(np.linalg.norm(np.cross(result, normal), axis=1), result @ normal)
    rms = np.degrees(np.sqrt(np.mean(error**2)))
    least = bound(normal, Lights(directions=directions), albedo=albedo, exposures_us=(exposure_us,))
    # The relative error of the mean square of two normal errors is at most 1 / sqrt(trials); that
    # of its root is half of it.
    sampling = 0.5 / np.sqrt(trials)
    assert least * (1 - 4 * sampling) < rms < 1.05 * least


def test_the_bound_holds_in_a_rendered_scene():
    """Near lights, painted albedo and cast shadows; light vectors are those of `Lights`."""
    scene = scene_named("coin", width=80, height=64, leds=20, seed=4, sharp=True)
    rendering = render(scene)
    truth, mask, exposure_us = rendering.truth, rendering.truth.mask, 20_000.0
    least = cramer_rao_deg(
        truth.normals,
        truth.albedo,
        scene.lights,
        Measurement(scene.noise, scene.electrons_per_us, (exposure_us,)),
        points_mm=truth.points_mm,
        shadows=truth.shadows,
    )
    assert np.isfinite(least[mask]).all()
    assert np.isnan(least[~mask]).all()
    lit = ~truth.shadows[:, mask]
    vectors = scene.lights.vectors_at(truth.points_mm[mask])
    vectors *= scene.electrons_per_us * exposure_us * scene.irradiance[:, None, None]
    normals = truth.normals[mask].astype(np.float64)
    squared = []
    for trial in range(12):
        grey = [
            sensor_image(plane * np.float32(exposure_us), scene.noise, key=(3, trial, led))[mask]
            for led, plane in enumerate(rendering.planes)
        ]
        electrons = (np.array(grey, np.float64) - scene.noise.black_level_dn) * 2.5
        weights = lit.astype(np.float64)
        for _ in range(3):
            left = np.einsum("np,npa,npb->pab", weights, vectors, vectors)
            right = np.einsum("np,npa,np->pa", weights, vectors, electrons)
            m = np.linalg.solve(left, right[..., None])[..., 0]
            signal = np.maximum(np.einsum("npa,pa->np", vectors, m), 0)
            weights = lit / variance_e(scene.noise, signal)
        sine = np.linalg.norm(np.cross(m, normals), axis=1)
        error = np.degrees(np.arctan2(sine, (m * normals).sum(axis=1)))
        squared.append((error / least[mask]) ** 2)
    # The error of the ratio's mean square over about 15 000 independent pixels is below 1 %.
    count = 12 * mask.sum()
    assert count > 10_000
    assert 1 - 4 * 0.5 / np.sqrt(count) < np.sqrt(np.mean(squared)) < 1.05


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        pytest.param({"albedo": np.ones((2, 2))}, r"albedo has shape \(2, 2\)", id="albedo"),
        pytest.param({"lights": Lights(positions_mm=np.eye(3))}, "require points_mm", id="points"),
        pytest.param({"shadows": np.ones((2, 2, 3), bool)}, "shadows has shape", id="shadows"),
        pytest.param({"exposures_us": ()}, "must be positive", id="no exposure"),
        pytest.param({"exposures_us": (1.0, 0.0)}, "must be positive", id="zero exposure"),
        pytest.param({"channel": np.zeros((3, 2), int)}, "channel has shape", id="channel"),
        pytest.param(
            {
                "lights": Lights(positions_mm=np.eye(3), axes=np.eye(3)),
                "points_mm": np.zeros((2, 3, 3)),
            },
            "L00 points away",
            id="axis",
        ),
        pytest.param({"photons_per_us": np.ones(7)}, "photons_per_us has shape", id="rate"),
    ],
)
def test_invalid_input_is_refused(changed, message):
    surface = {
        "normals": np.ones((2, 3, 3), np.float32),
        "albedo": np.ones((2, 3), np.float32),
        "lights": Lights(directions=np.eye(3)),
        "points_mm": None,
        "shadows": None,
    }
    measured = {name: value for name, value in changed.items() if name not in surface}
    surface |= {name: value for name, value in changed.items() if name in surface}
    with pytest.raises(DataError, match=message):
        cramer_rao_deg(**surface, measurement=dataclasses.replace(MEASUREMENT, **measured))
