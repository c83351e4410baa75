"""Height of surfaces under near lights, compared with closed forms."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from acquisition import CameraModel, DataError, LightErrors, Lights, angle_deg
from processing import NormalMap, integrate, photometric_stereo
from processing.images.viewing_rays import Parallel, Perspective
from processing.near.near_height import near_height
from simulator import render, scene_named
from tests.quick_sample import quick

SIZE = (60, 80)
DISTANCE = 600.0
CAMERA = CameraModel(
    np.array([[420.0, 0, 39.5], [0, 420, 29.5], [0, 0, 1]]),
    SIZE[1],
    SIZE[0],
    working_distance_mm=DISTANCE,
)
VIEW = Perspective(CAMERA)
Y, X = np.indices(SIZE)
DISC = (X - 39.5) ** 2 + (Y - 29.5) ** 2 < 26**2


def dome(scale=1.0, count=16):
    """Return LEDs in two rings, 450 mm from the origin."""
    turn = np.radians(np.arange(count) * 360 / count)
    tilt = np.radians(np.resize([25.0, 50.0], count))
    away = np.stack(
        [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], axis=1
    )
    return Lights(positions_mm=450.0 * scale * away, axes=-away, mu=np.ones(count))


def plane(slope, height):
    """Return depth and normals of a plane whose mean height over the disc is ``height``."""
    normal = np.array([-slope[0], -slope[1], 1.0]) / math.hypot(1, *slope)
    rays, centre = CAMERA.pixel_rays(), CAMERA.centre_mm
    at_origin = -(centre @ normal) / (rays @ normal)
    depth = at_origin * (DISTANCE - height) / at_origin[DISC].mean()
    return depth, np.broadcast_to(normal, (*SIZE, 3))


def ball(radius, height):
    """Return depth and normals of a spherical cap whose mean height is ``height``."""
    rays, camera_centre = CAMERA.pixel_rays(), CAMERA.centre_mm
    low, high = height - 2 * radius, height
    for _ in range(60):  # bisection of the height of the centre
        middle = (low + high) / 2
        toward = camera_centre - np.array([0, 0, middle])
        a = (rays**2).sum(axis=-1)
        b = rays @ toward
        root = np.sqrt(np.maximum(b**2 - a * (toward @ toward - radius**2), 0))
        depth = (-b - root) / a
        if DISTANCE - depth[DISC].mean() > height:
            high = middle
        else:
            low = middle
    points = CAMERA.points_at(depth)
    normals = points - np.array([0, 0, middle])
    return depth, normals / np.linalg.norm(normals, axis=-1, keepdims=True)


SURFACES = {
    "flat": lambda height: plane((0.0, 0.0), height),
    "tilted": lambda height: plane((0.25, -0.1), height),
    "cap": lambda height: ball(70.0, height),
    "steep": lambda height: plane((2.0, -0.3), height),
}


def images(depth, normals, lights, noise=0.0, seed=0, view=VIEW):
    points = view.points_at(depth)
    albedo = 0.5 + 0.2 * np.sin(X / 5) * np.cos(Y / 7)
    vectors = lights.vectors_at(points)
    values = albedo * np.maximum((vectors * normals).sum(axis=-1), 0)
    rng = np.random.default_rng(seed)
    return (values + noise * rng.normal(size=values.shape)).astype(np.float32)


LIGHTS = dome()


def seen(kind, height, lights=LIGHTS, noise=0.0):
    """Return depth, normals and images of a surface."""
    depth, normals = SURFACES[kind](height)
    return depth, normals, images(depth, normals, lights, noise)


@pytest.mark.parametrize(
    ("kind", "height"),
    quick(list(itertools.product(["flat", "tilted", "cap"], [-40.0, 0.0, 6.0, 70.0])), every=12),
)
def test_exact_images_give_the_exact_surface(kind, height):
    depth, _, values = seen(kind, height)
    found = near_height(values, LIGHTS, DISC, VIEW)
    assert not found.warnings
    assert found.mean_height_mm == pytest.approx(height, abs=0.05)
    assert np.abs(found.depth - depth)[DISC].max() < 0.2
    assert found.steps[-1].change_mm < found.steps[0].change_mm / 20 or height == 0


@pytest.mark.parametrize("height", [60.0, 150.0])
def test_steep_surfaces_do_not_look_like_a_plane_at_any_height(height):
    """The best height of a plane is uncertain, or at the limit; later surfaces show it."""
    depth, _, values = seen("steep", height, noise=0.002)
    found = near_height(values, LIGHTS, DISC, VIEW)
    assert not found.warnings
    assert np.abs(found.depth - depth)[DISC].max() < 0.2


PARALLEL = Parallel(1.4, SIZE, (39.5, 29.5))
ACROSS, UP, _ = np.moveaxis(PARALLEL.points_at(0.0), 2, 0)
RADIUS = 70.0
LEVEL = np.sqrt(np.maximum(RADIUS**2 - ACROSS**2 - UP**2, 1.0))
SEEN_IN_PARALLEL = {
    "tilted": (0.25 * ACROSS - 0.1 * UP, np.stack([0 * UP - 0.25, 0 * UP + 0.1, 1 + 0 * UP], 2)),
    "cap": (LEVEL, np.stack([ACROSS, UP, LEVEL], 2)),
}


@pytest.mark.parametrize("kind", quick(SEEN_IN_PARALLEL, every=2))
@pytest.mark.parametrize("fixed", quick(["found", "stated", "rests"], every=2))
def test_parallel_rays_give_the_exact_surface(kind, fixed):
    shape, normals = SEEN_IN_PARALLEL[kind]
    normals = normals / np.linalg.norm(normals, axis=2, keepdims=True)
    at = np.quantile(shape[DISC], 0.005) if fixed == "rests" else shape[DISC].mean() - 30.0
    heights = shape - at
    options = {"stated": {"height_mm": 30.0}, "rests": {"rests_on_plane": True}}.get(fixed, {})
    values = images(-heights, normals, dome(), view=PARALLEL)
    found = near_height(values, dome(), DISC, PARALLEL, **options)
    assert not found.warnings
    assert np.abs(found.depth + heights)[DISC].max() < 0.3
    assert found.mean_height_mm == pytest.approx(heights[DISC].mean(), abs=0.2)
    solved = photometric_stereo(values, dome(), DISC, points_mm=PARALLEL.points_at(found.depth))
    surface = integrate(solved.normal_map, pixel_mm=1.4, depth_mm=found.depth)
    assert np.abs(surface.height - heights)[DISC].max() < 0.3


def test_views_in_blocks_see_the_middle_of_their_pixels():
    for view in (VIEW, PARALLEL):
        centres = view.points_at(-7.0 if view is PARALLEL else 590.0)
        blocks = centres.reshape(30, 2, 40, 2, 3).mean(axis=(1, 3))
        coarse = view.downscaled(2).points_at(-7.0 if view is PARALLEL else 590.0)
        np.testing.assert_allclose(coarse, blocks, atol=1e-9)


@pytest.mark.parametrize("kind", quick(["tilted", "cap"], every=2))
def test_normals_are_those_with_the_true_points(kind):
    depth, normals, values = seen(kind, 25.0, noise=0.004)
    found = near_height(values, LIGHTS, DISC, VIEW)

    def error(at):
        points = CAMERA.points_at(at)
        solved = photometric_stereo(values, LIGHTS, DISC, points_mm=points, method="ls")
        return angle_deg(solved.normal_map.normals, normals)[DISC].mean()

    assert error(found.depth) < 1.01 * error(depth)
    assert error(found.depth) < 0.5 * error(np.full(SIZE, DISTANCE))


def coin():
    """Return images of a rendered coin under 36 LEDs, divided by the strengths, and its truth."""
    scene = scene_named("coin", width=120, height=100, leds=36, seed=4)
    rendering = render(replace(scene, ambient=0.0))
    truth, planes = rendering.truth, rendering.planes
    full = np.quantile(planes[:, truth.mask], 0.999) / 0.8
    photons = np.random.default_rng(4).poisson(1e4 * np.clip(planes / full, 0, 1))
    strengths = np.asarray(truth.lights.intensities).mean(axis=1)[:, None, None]
    return np.float32(np.where(photons < 1e4, photons / 1e4, np.nan) / strengths), truth


@pytest.mark.slow
def test_lights_that_are_off_alike_are_reported_or_in_the_deviation():
    """All lights are 10 mm too high. The common part of stated errors is in the deviation."""
    values, truth = coin()
    lights = Lights(
        positions_mm=truth.lights.positions_mm, axes=truth.lights.axes, mu=truth.lights.mu
    )
    stated = LightErrors(covariances=np.tile(np.diag([0.5, 0.5, 4.0]), (36, 1, 1)))
    view = Perspective(truth.camera)
    right = near_height(values, replace(lights, errors=stated), truth.mask, view)
    assert not right.warnings
    assert right.mean_height_mm == pytest.approx(np.nanmean(truth.height_mm[truth.mask]), abs=0.3)
    high = replace(lights, positions_mm=np.add(lights.positions_mm, [0, 0, 10.0]))
    wrong = near_height(values, high, truth.mask, view)
    (notice,) = wrong.warnings
    assert notice.code == "height-doubtful"
    assert "if all lights were lower" in notice.text
    off = wrong.mean_height_mm - right.mean_height_mm
    assert off > 10 * wrong.mean_height_sigma_mm
    # Five standard deviations of 2 mm.
    assert 5 * right.mean_height_sigma_mm == pytest.approx(off, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("kind", SURFACES)
def test_the_standard_deviation_is_that_of_the_heights(kind):
    lights = dome()
    depth, normals = SURFACES[kind](12.0)
    scores = []
    for seed in range(8):
        values = images(depth, normals, lights, noise=0.005, seed=100 + seed)
        found = near_height(values, lights, DISC, VIEW)
        scores.append((found.mean_height_mm - 12.0) / found.mean_height_sigma_mm)
    assert 0.7 < np.sqrt(np.mean(np.square(scores))) < 1.4
    assert abs(np.mean(scores)) < 0.6


@pytest.mark.slow
@pytest.mark.parametrize(("intensity", "position_mm"), [(0.01, 0.0), (0.0, 3.0)])
def test_the_standard_deviation_contains_errors_of_single_lights(intensity, position_mm):
    lights = dome()
    depth, normals = SURFACES["cap"](12.0)
    scores = []
    for seed in range(8):
        rng = np.random.default_rng(200 + seed)
        values = images(depth, normals, lights, noise=0.002, seed=seed)
        values *= (1 + intensity * rng.normal(size=(16, 1, 1))).astype(np.float32)
        moved = lights.positions_mm + position_mm * rng.normal(size=(16, 3))
        wrong = Lights(positions_mm=moved, axes=lights.axes, mu=lights.mu)
        found = near_height(values, wrong, DISC, VIEW)
        scores.append((found.mean_height_mm - 12.0) / found.mean_height_sigma_mm)
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.6


def test_a_stated_height_is_kept():
    depth, _, values = seen("tilted", 25.0)
    found = near_height(values, LIGHTS, DISC, VIEW, height_mm=25.0)
    assert found.mean_height_mm == pytest.approx(25.0, abs=1e-3)
    assert not found.warnings
    # Gloss makes objects look higher than they are, and nothing makes them look lower.
    assert not near_height(values, LIGHTS, DISC, VIEW, height_mm=15.0).warnings
    (notice,) = near_height(values, LIGHTS, DISC, VIEW, height_mm=35.0).warnings
    assert notice.code == "height-contradicted"
    assert "10.0 mm lower than stated" in notice.text
    assert math.isnan(found.mean_height_sigma_mm)
    assert np.abs(found.depth - depth)[DISC].max() < 0.1


def test_an_object_that_rests_on_the_plane():
    depth, normals = SURFACES["cap"](25.0)
    lift = float((DISTANCE - depth[DISC]).min())
    depth, normals = SURFACES["cap"](25.0 - lift)
    found = near_height(images(depth, normals, LIGHTS), LIGHTS, DISC, VIEW, rests_on_plane=True)
    heights = DISTANCE - found.depth[DISC]
    assert np.quantile(heights, 0.005) == pytest.approx(0, abs=0.2)
    assert found.mean_height_mm == pytest.approx(25.0 - lift, abs=0.5)


def test_heights_that_the_images_do_not_show_are_reported():
    """The lights are so far away that their irradiance is the same everywhere."""
    lights = dome(scale=100.0)
    values = seen("tilted", 10.0, lights, noise=0.01)[2]
    found = near_height(values, lights, DISC, VIEW)
    assert [note.code for note in found.warnings] == ["height-not-determined"]
    assert (found.depth == DISTANCE).all()


@pytest.mark.parametrize("count", [3, 4, 5])
def test_few_lights_do_not_show_the_height(count):
    """Three samples are explained at any height."""
    lights = dome().take(list(range(0, 16, 16 // count))[:count])
    depth, _, values = seen("tilted", 25.0, lights, noise=0.004)
    found = near_height(values, lights, DISC, VIEW)
    if count < 5:
        assert [note.code for note in found.warnings] == ["height-not-determined"]
        assert (found.depth == DISTANCE).all()
    else:
        assert abs(found.mean_height_mm - 25.0) < 4 * found.mean_height_sigma_mm
    stated = near_height(values, lights, DISC, VIEW, height_mm=25.0)
    assert np.abs(stated.depth - depth)[DISC].max() < 3


def test_pixels_that_few_lights_reach_do_not_count():
    values = seen("tilted", 25.0)[2]
    values[4:, :, :40] = 0.0
    found = near_height(values, LIGHTS, DISC, VIEW, height_mm=None)
    assert np.isfinite(found.depth).all()
    assert not found.warnings


@pytest.mark.parametrize("bad", ["noise", "one pixel", "black"])
def test_images_without_a_surface_keep_the_plane(bad):
    lights, mask = dome(), DISC.copy()
    values = np.zeros((16, *SIZE), np.float32)
    if bad == "noise":
        values = np.random.default_rng(0).uniform(0, 1, values.shape).astype(np.float32)
    elif bad == "one pixel":
        mask[:] = False
        mask[20, 30] = True
        values += 0.3
    found = near_height(values, lights, mask, VIEW)
    assert np.isfinite(found.depth).all()
    if bad != "noise":
        assert [note.code for note in found.warnings] == ["height-not-determined"]


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"height_mm": 900.0}, "a height of 900 mm puts the object behind lights or camera"),
        ({"height_mm": -700.0}, "behind lights or camera: give a height from -225 to"),
        ({"height_mm": 3.0, "rests_on_plane": True}, "give one of them"),
    ],
)
def test_impossible_heights_are_refused(options, text):
    with pytest.raises(DataError, match=text):
        near_height(np.ones((16, *SIZE), np.float32), dome(), DISC, VIEW, **options)


def test_large_images_are_averaged(monkeypatch):
    depth, _, values = seen("tilted", 25.0)
    values[3, 20:24, 30:35] = np.nan
    monkeypatch.setattr("processing.images.coarse_images._PIXELS", 200)
    found = near_height(values, LIGHTS, DISC, VIEW)
    assert found.mean_height_mm == pytest.approx(25.0, abs=0.3)
    inner = (X - 39.5) ** 2 + (Y - 29.5) ** 2 < 22**2
    assert np.abs(found.depth - depth)[inner].max() < 0.5


def test_integration_at_an_approximate_depth():
    depth, normals = SURFACES["cap"](25.0)
    normal_map = NormalMap.from_vectors(normals.astype(np.float32), DISC)
    surface = integrate(normal_map, camera=CAMERA, depth_mm=depth.astype(np.float32) + 0.5)
    assert np.abs(surface.depth - depth - 0.5)[DISC].max() < 0.05
    assert np.abs(surface.height - (DISTANCE - depth - 0.5))[DISC].max() < 0.05
    for wrong in (depth[:5], -depth, depth * np.nan):
        with pytest.raises(DataError, match="must be positive at all pixels"):
            integrate(normal_map, camera=CAMERA, depth_mm=wrong.astype(np.float32))
    with pytest.raises(DataError, match="require a camera with a working distance"):
        integrate(normal_map, depth_mm=depth.astype(np.float32))
