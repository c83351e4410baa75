"""Scenes refuse invalid values, and the bench has its documented properties."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from acquisition import CameraModel, DataError, Lights
from simulator import SCENES, ChromeSphere, Lens, bench_camera, dome_lights, render, scene_named
from simulator.shapes import Paint, Plane
from tests.quick_sample import quick

COIN = scene_named("coin", width=64, height=48, leds=4)
SPHERES = scene_named("spheres", width=64, height=48, leds=4)


def _lights(*positions, **more):
    return Lights(positions_mm=np.array(positions, float), **more)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        pytest.param(lambda: scene_named("teapot"), "unknown scene 'teapot'.*coin", id="name"),
        pytest.param(
            lambda: scene_named("charuco", amplitude_mm=1.0), "no relief", id="no-relief-to-scale"
        ),
        pytest.param(
            lambda: scene_named("noise", amplitude_mm=-1.0), "amplitude is -1", id="amplitude"
        ),
        pytest.param(
            lambda: scene_named("sphere", amplitude_mm=70.0), "must not exceed", id="high-sphere"
        ),
        pytest.param(lambda: scene_named("coin", width=0), "no pixels", id="zero-width"),
        pytest.param(lambda: scene_named("coin", height=-3), "no pixels", id="negative-height"),
        pytest.param(lambda: scene_named("coin", leds=0), "0 LEDs", id="no-leds"),
        pytest.param(lambda: dome_lights(radius_mm=-450), "radius -450", id="negative-dome"),
        pytest.param(lambda: ChromeSphere((0, 0, 5), -5), "radius of -5", id="negative-sphere"),
        pytest.param(lambda: ChromeSphere((0, 0), 5), "three finite", id="flat-sphere"),
        pytest.param(lambda: ChromeSphere((0, 0, 5), 5, 1.2), "reflectance", id="bright-sphere"),
        pytest.param(lambda: Paint(0.5, 0.2), "low 0.5, high 0.2", id="paint-order"),
        pytest.param(lambda: Paint(0.5, 1.2), "low 0.5, high 1.2", id="paint-range"),
        pytest.param(
            lambda: replace(COIN, lights=_lights((0, 0, 5.0))),
            "LED L00 is below the surface",
            id="led-in-the-coin",
        ),
        pytest.param(
            lambda: replace(COIN, lights=_lights((0, 0, 400.0), (300, 0, -1.0))),
            "LED L01 is below the surface",
            id="led-below-the-board",
        ),
        pytest.param(
            lambda: replace(COIN, lights=_lights((0, 0, 400.0), axes=np.array([[0, 0, 1.0]]))),
            "LED L00 points away",
            id="led-turned-away",
        ),
        pytest.param(
            lambda: replace(COIN, lights=Lights(directions=np.array([[0, 0, 1.0], [1, 0, 0]]))),
            "light L01 is below",
            id="distant-light-from-below",
        ),
        pytest.param(
            lambda: replace(SPHERES, lights=_lights(SPHERES.spheres[2].centre_mm)),
            "LED L00 is inside sphere 2",
            id="led-in-a-sphere",
        ),
        pytest.param(
            lambda: replace(COIN, spheres=(ChromeSphere((85, 0, 12), 12),)),
            "sphere 0 overlaps the object",
            id="sphere-on-the-object",
        ),
        pytest.param(
            lambda: replace(
                SPHERES, spheres=(ChromeSphere((0, 0, 12), 12), ChromeSphere((20, 0, 12), 12))
            ),
            "spheres 0 and 1 overlap",
            id="sphere-on-sphere",
        ),
        pytest.param(
            lambda: replace(SPHERES, spheres=(ChromeSphere((0, 0, 5), 12),)),
            "sphere 0 intersects the board",
            id="sunk-sphere",
        ),
        pytest.param(
            lambda: replace(SPHERES, spheres=(ChromeSphere((0, 0, 300), 300),)),
            "sphere 0 reaches the camera",
            id="camera-in-a-sphere",
        ),
        pytest.param(
            lambda: replace(COIN, lens=Lens(replace(COIN.camera, working_distance_mm=8.0))),
            "inside the object",
            id="camera-in-the-coin",
        ),
        pytest.param(
            lambda: Lens(replace(COIN.camera, distortion=np.array([-5.0]))),
            "folds the image",
            id="folding-distortion",
        ),
        pytest.param(
            lambda: Lens(CameraModel(COIN.camera.K, 64, 48)),
            "working distance",
            id="no-working-distance",
        ),
        pytest.param(
            lambda: replace(COIN, board_radius_mm=0.0), "board_radius_mm is 0.0", id="no-board"
        ),
        pytest.param(
            lambda: replace(COIN, electrons_per_us=0.0), "electrons_per_us is 0.0", id="no-signal"
        ),
        pytest.param(lambda: replace(COIN, ambient=math.nan), "ambient is nan", id="ambient"),
        pytest.param(
            lambda: replace(COIN, soft_shadow_samples=0),
            "soft_shadow_samples is 0",
            id="no-shadow-samples",
        ),
        pytest.param(
            lambda: replace(COIN, led_radius_mm=-2.0), "led_radius_mm is -2.0", id="led-radius"
        ),
        pytest.param(
            lambda: render(scene_named("coin", width=16384, height=16384, leds=4096)),
            "4096 images of 16384 x 16384 pixels requires .* GiB",
            id="over-memory",
        ),
        pytest.param(
            lambda: render(
                replace(
                    COIN,
                    body=Plane(60.0, 120.0),
                    spheres=(ChromeSphere((69, 0, 8), 8),),
                )
            ),
            "the object hides part of sphere 0",
            id="sphere-behind-the-object",
        ),
    ],
)
def test_an_invalid_scene_is_reported_in_one_line(make, message):
    with pytest.raises(DataError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


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
