"""Scenes refuse invalid values, and the bench has its documented properties."""

import cv2
import numpy as np
import pytest

from acquisition import Lights
from simulator import SCENES, bench_camera, dome_lights, render, scene_named
from simulator.shapes import Paint
from tests.quick_sample import quick

COIN = scene_named("coin", width=64, height=48, leds=4)
SPHERES = scene_named("spheres", width=64, height=48, leds=4)


def _lights(*positions, **more):
    return Lights(positions_mm=np.array(positions, float), **more)


@pytest.mark.parametrize("count", [1, 2, 3, 7, 36, 64])
def test_leds_are_on_the_dome(count):
    lights = dome_lights(count, 450.0, seed=3, jitter_mm=0.0)
    assert len(lights) == count
    np.testing.assert_allclose(np.linalg.norm(lights.positions_mm, axis=1), 450.0)
    assert np.all(lights.positions_mm[:, 2] > 200)
    np.testing.assert_allclose(lights.axes, -lights.positions_mm / 450.0, atol=1e-12)


def test_dome_of_36_surrounds_the_object():
    lights = dome_lights(36, seed=1)
    azimuth = np.degrees(np.arctan2(lights.positions_mm[:, 1], lights.positions_mm[:, 0]))
    counts, _ = np.histogram(azimuth, bins=6, range=(-180, 180))
    assert counts.min() >= 4
    assert np.linalg.matrix_rank(lights.unit_directions) == 3
    assert lights.intensities[:, 0].std() == pytest.approx(0.03, rel=0.4)


def test_dome_depends_on_its_seed():
    a, again, b = dome_lights(9, seed=5), dome_lights(9, seed=5), dome_lights(9, seed=6)
    np.testing.assert_array_equal(a.positions_mm, again.positions_mm)
    assert np.abs(a.positions_mm - b.positions_mm).max() > 1.0


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in ("coin", "spheres") else pytest.mark.slow)
        for name in SCENES
    ],
)
def test_all_scenes_have_the_same_dome(name):
    lights = scene_named(name, leds=5, seed=8).lights
    np.testing.assert_array_equal(lights.positions_mm, dome_lights(5, seed=8).positions_mm)


@pytest.mark.parametrize(("width", "height"), [(640, 512), (2448, 2048)])
def test_width_of_the_field_does_not_depend_on_the_size(width, height):
    camera = bench_camera(width, height)
    assert width / camera.K[0, 0] * 600 == pytest.approx(293.76)


def test_exposure_time_suits_the_sensor():
    rendering = render(scene_named("coin", width=160, height=128, seed=4))
    noise = rendering.truth.noise
    full = (noise.white_level_dn - noise.black_level_dn) * noise.electrons_per_dn
    signal = 20_000 * (rendering.planes + rendering.ambient)
    lit = signal[:, rendering.truth.mask] / full
    assert 0.55 < np.percentile(lit, 99) < 0.75
    assert lit.max() < 0.95


def test_paint_reaches_its_bounds_and_does_not_exceed_them():
    x, y = np.meshgrid(np.linspace(-80, 80, 200), np.linspace(-80, 80, 200))
    albedo = Paint(0.35, 0.75, 60.0, seed=1).evaluate(x, y)
    assert 0.35 <= albedo.min() < 0.42
    assert 0.68 < albedo.max() <= 0.75


@pytest.mark.parametrize("name", quick(SCENES, every=3))
def test_every_scene_renders_within_the_sensor(name):
    scene = scene_named(name, width=100, height=80, leds=4, seed=2)
    rendering = render(scene)
    truth = rendering.truth
    assert np.isfinite(rendering.planes).all()
    assert truth.mask.any() == (scene.body is not None)
    length = np.linalg.norm(truth.normals, axis=-1)
    np.testing.assert_allclose(length, truth.mask, atol=1e-6)
    full = (scene.noise.white_level_dn - 64) * scene.noise.electrons_per_dn
    lit = 20_000 * rendering.planes[:, truth.mask] / full
    assert lit.size == 0 or 0.3 < np.percentile(lit, 99) < 0.95


@pytest.mark.parametrize(
    "name", quick(["coin", "ripples", "scales", "textile", "leather", "noise"], every=3)
)
def test_amplitude_scales_the_relief(name):
    low, high = (
        render(scene_named(name, width=80, height=64, leds=1, amplitude_mm=mm)).truth
        for mm in (0.2, 0.4)
    )
    both = low.mask & high.mask
    tilt = [
        np.hypot(t.normals[both][:, 0], t.normals[both][:, 1]) / t.normals[both][:, 2]
        for t in (low, high)
    ]
    ratio = np.median(tilt[1]) / np.median(tilt[0])
    # The coin's dome does not change.
    assert 1 < ratio < 2 if name == "coin" else ratio == pytest.approx(2.0, abs=0.15)


def test_seed_changes_the_texture_but_not_its_statistics():
    a, again, b = (
        render(scene_named("leather", width=64, height=48, leds=1, seed=s)).truth for s in (1, 1, 2)
    )
    np.testing.assert_array_equal(a.normals, again.normals)
    assert np.abs(a.normals - b.normals).max() > 0.1


@pytest.mark.slow
def test_opencv_detects_the_charuco_board():
    scene = scene_named("charuco", width=800, height=640, leds=5)
    seen = render(scene).planes.sum(axis=0)
    # A lens blurs edges; for undersampled edges OpenCV has errors of a tenth of a pixel.
    seen = cv2.GaussianBlur(seen, (0, 0), 1.0)
    grey = np.uint8(255 * seen / seen.max())
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250)
    pattern = scene.pattern
    board = cv2.aruco.CharucoBoard((pattern.columns, pattern.rows), 4.0, 3.0, dictionary)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(grey)
    assert len(ids) == (pattern.columns - 1) * (pattern.rows - 1)
    places = np.column_stack([pattern.corners_mm, np.zeros(len(pattern.corners_mm))])
    expected = scene.lens.project(places[ids.ravel()])
    assert np.abs(corners.reshape(-1, 2) - expected).max() < 0.15
