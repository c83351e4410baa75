"""Mirrored LEDs: place, energy and width against the law of reflection and brute force."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import Lights
from simulator import ChromeSphere, find_highlights, render, scene_named
from simulator._chrome import mirror_points, splat

SCENE = scene_named("spheres", width=320, height=256, seed=11)
RENDERING = render(SCENE)


def _pixel_ray(camera, pixel):
    ray = np.linalg.solve(camera.K, [*pixel, 1.0]) * [1, -1, -1]
    return ray / np.linalg.norm(ray)


def _mirrored(camera, sphere, pixel):
    """Start and direction of a pixel's ray after the sphere, by the quadratic formula."""
    eye = np.array([0, 0, camera.working_distance_mm])
    ray, offset = _pixel_ray(camera, pixel), eye - sphere.centre_mm
    b = ray @ offset
    t = -b - np.sqrt(b * b - offset @ offset + sphere.radius_mm**2)
    start = eye + t * ray
    normal = (start - sphere.centre_mm) / sphere.radius_mm
    return start, ray - 2 * (ray @ normal) * normal


def _pairs(scene):
    for s, sphere in enumerate(scene.spheres):
        for n in range(len(scene.lights)):
            yield s, n, sphere, scene.lights.positions_mm[n]


def test_every_led_shows_in_every_sphere():
    assert np.isfinite(RENDERING.truth.highlights_px).all()


def test_ray_of_the_highlight_meets_the_led():
    for s, n, sphere, led in _pairs(SCENE):
        start, direction = _mirrored(SCENE.camera, sphere, RENDERING.truth.highlights_px[s, n])
        miss = np.linalg.norm(np.cross(led - start, direction))
        assert miss < 1e-6
        assert (led - start) @ direction > 0


@settings(max_examples=60, deadline=None)
@given(
    place=st.tuples(st.floats(-150, 150), st.floats(-150, 150), st.floats(0, 50)),
    radius=st.floats(1, 30),
    led=st.tuples(st.floats(-500, 500), st.floats(-500, 500), st.floats(120, 600)),
)
def test_mirror_point_obeys_the_law_of_reflection(place, radius, led):
    sphere, eye, led = ChromeSphere(place, radius), np.array([0, 0, 600.0]), np.array(led)
    points, visible = mirror_points(eye, sphere, led[None])
    assert visible[0]
    normal = (points[0] - place) / radius
    assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-9)
    to_eye, to_led = eye - points[0], led - points[0]
    half = to_eye / np.linalg.norm(to_eye) + to_led / np.linalg.norm(to_led)
    # The half way between both directions is the normal, on the outer side.
    np.testing.assert_allclose(half / np.linalg.norm(half), normal, atol=1e-9)


def test_led_on_the_line_of_sight_shows_at_the_centre():
    sphere = ChromeSphere((40.0, -30.0, 15.0), 15.0)
    eye = np.array([0, 0, 600.0])
    led = eye + 0.4 * (np.array(sphere.centre_mm) - eye)
    points, visible = mirror_points(eye, sphere, led[None])
    toward = (eye - sphere.centre_mm) / np.linalg.norm(eye - sphere.centre_mm)
    assert visible[0]
    np.testing.assert_allclose(points[0], sphere.centre_mm + 15.0 * toward, atol=1e-9)


def test_led_behind_the_sphere_is_not_seen():
    sphere, eye = ChromeSphere((0, 0, 100.0), 50.0), np.array([0, 0, 600.0])
    _, visible = mirror_points(eye, sphere, np.array([[0.0, 0.1, 20.0], [300.0, 0, 300.0]]))
    assert visible.tolist() == [False, True]


def test_sphere_in_the_way_hides_the_highlight():
    low = Lights(positions_mm=np.array([[300.0, 0, 30.0], [-300.0, 0, 300.0]]))
    pair = (ChromeSphere((-60.0, 0, 20.0), 20.0), ChromeSphere((40.0, 0, 20.0), 20.0))
    seen = np.isfinite(find_highlights(replace(SCENE, lights=low, spheres=pair)).signal)
    assert seen.tolist() == [[False, True], [True, True]]


def test_light_from_the_right_shows_right_of_the_centre():
    lights = Lights(positions_mm=np.array([[300.0, 0, 300.0], [0.0, 300, 300]]))
    sphere = (ChromeSphere((0, 0, 20.0), 20.0),)
    x, y = find_highlights(replace(SCENE, lights=lights, spheres=sphere)).pixels[0].T
    centre_x, centre_y = SCENE.camera.K[0, 2], SCENE.camera.K[1, 2]
    assert x[0] > centre_x + 5
    assert y[0] == pytest.approx(centre_y)
    assert y[1] < centre_y - 5
    assert x[1] == pytest.approx(centre_x)


def _spot(plane, pixel, reach=6):
    """Centroid and sum of what is brighter than anything matte around a highlight."""
    x0, y0 = np.round(pixel).astype(int)
    window = plane[y0 - reach : y0 + reach + 1, x0 - reach : x0 + reach + 1].astype(float)
    y, x = np.mgrid[y0 - reach : y0 + reach + 1, x0 - reach : x0 + reach + 1]
    spot = np.clip(window - 0.5 * SCENE.electrons_per_us, 0, None)
    return np.array([(spot * x).sum(), (spot * y).sum()]) / spot.sum(), spot.sum()


def test_drawn_highlight_lies_where_the_truth_says():
    worst = max(
        np.abs(
            _spot(RENDERING.planes[n], RENDERING.truth.highlights_px[s, n])[0]
            - RENDERING.truth.highlights_px[s, n]
        ).max()
        for s, n, _, _ in _pairs(SCENE)
    )
    assert worst < 0.02


def test_drawn_highlight_holds_its_energy():
    dark = replace(SCENE, board_albedo=0.0, surroundings=0.0, ambient=0.0)
    signal = find_highlights(dark).signal * dark.electrons_per_us
    planes = render(dark).planes
    for s, mask in enumerate(RENDERING.truth.sphere_masks):
        total = planes[:, _wider(mask)].sum(axis=1)
        np.testing.assert_allclose(total, signal[s], rtol=1e-4)


def _wider(mask, by=6):
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    wide = np.zeros_like(mask)
    wide[rows[0] - by : rows[-1] + by, columns[0] - by : columns[-1] + by] = True
    return wide


@pytest.mark.parametrize(
    ("turn", "mu"),
    [
        pytest.param((0.0, 0.0, 0.0), 1.0, id="lambertian"),
        pytest.param((0.5, -0.4, 0.2), 3.0, id="narrow-and-askew"),
    ],
)
def test_energy_agrees_with_counting_rays(turn, mu):
    """Trace a fine grid of rays and count those that end on the luminous disc."""
    n, radius, fine = 5, 12.0, 60
    lights = replace(SCENE.lights, axes=SCENE.lights.axes + turn, mu=np.full(len(SCENE.lights), mu))
    scene = replace(SCENE, led_radius_mm=radius, lights=lights)
    found, sphere = find_highlights(scene), scene.spheres[0]
    led, axis = scene.lights.positions_mm[n], scene.lights.axes[n]
    pixel, on_disc, weight = found.pixels[0, n], 0, 0.0
    for dx in (np.arange(2 * fine) + 0.5) / fine - 1:
        for dy in (np.arange(2 * fine) + 0.5) / fine - 1:
            start, way = _mirrored(scene.camera, sphere, pixel + 0.8 * np.array([dx, dy]))
            end = start + ((led - start) @ axis) / (way @ axis) * way
            if np.linalg.norm(end - led) < radius:
                cosine = -(way @ axis)
                on_disc += 1
                weight += cosine ** (mu - 1)
    assert on_disc > 200
    # A disc of radiance L cos^(mu-1) gives E = L pi a^2 cos^mu / r^2; white shows E / pi.
    squared = led @ led
    at_origin = (-(led @ axis) / np.sqrt(squared)) ** mu
    radiance = scene.irradiance[n] * squared / at_origin / (np.pi * radius**2)
    expected = np.pi * sphere.reflectance * radiance * weight * (0.8 / fine) ** 2
    assert found.signal[0, n] == pytest.approx(expected, rel=0.02)


def test_energy_follows_radiance_and_not_the_disc():
    base = find_highlights(SCENE)
    lights = replace(SCENE.lights, intensities=2 * SCENE.lights.intensities)
    brighter = find_highlights(replace(SCENE, lights=lights))
    wider = find_highlights(replace(SCENE, led_radius_mm=20.0))
    np.testing.assert_allclose(brighter.signal, 2 * base.signal, rtol=1e-12)
    np.testing.assert_allclose(wider.signal, base.signal, rtol=1e-12)
    assert np.all(wider.sigma_px > base.sigma_px)


def test_energy_in_pixels_grows_with_the_square_of_the_resolution():
    fine = find_highlights(scene_named("spheres", width=1280, height=1024, seed=11))
    np.testing.assert_allclose(fine.signal, 16 * find_highlights(SCENE).signal, rtol=1e-4)


@pytest.mark.parametrize(
    ("x", "y", "sigma"),
    [(20.0, 14.0, 0.7), (20.37, 14.81, 0.7), (20.5, 14.5, 1.9)],
)
def test_splat_keeps_sum_place_and_width(x, y, sigma):
    plane = np.zeros((30, 40), np.float32)
    splat(plane, x, y, sigma, 5.0)
    rows, columns = np.mgrid[:30, :40]
    assert plane.sum() == pytest.approx(5.0, rel=1e-5)
    at_x, at_y = (plane * columns).sum() / plane.sum(), (plane * rows).sum() / plane.sum()
    assert (at_x, at_y) == pytest.approx((x, y), abs=1e-4)
    variance = (plane * (columns - x) ** 2).sum() / plane.sum()
    assert variance == pytest.approx(sigma**2 + 1 / 12, rel=0.1)


@pytest.mark.parametrize(("x", "y"), [(-0.4, 5.0), (39.4, 29.3), (-50.0, 5.0), (5.0, 200.0)])
def test_splat_at_the_border_draws_only_inside(x, y):
    plane = np.zeros((30, 40), np.float32)
    splat(plane, x, y, 0.7, 5.0)
    assert 0 <= plane.sum() < 5.0
    assert np.isfinite(plane).all()


def test_sphere_masks_follow_the_cone_of_tangents():
    camera = SCENE.camera
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(camera.K).T * [1, -1, -1]
    for sphere, mask in zip(SCENE.spheres, RENDERING.truth.sphere_masks, strict=True):
        to_centre = np.array(sphere.centre_mm) - [0, 0, camera.working_distance_mm]
        miss = np.linalg.norm(np.cross(rays, to_centre), axis=-1) / np.linalg.norm(rays, axis=-1)
        np.testing.assert_array_equal(mask, miss < sphere.radius_mm)


def test_outline_is_smoothed():
    black = replace(
        SCENE,
        spheres=tuple(replace(s, reflectance=0.0) for s in SCENE.spheres),
        surroundings=0.0,
        ambient=1.0,
    )
    level = black.board_albedo * black.electrons_per_us
    covered = 1 - render(black).ambient / level
    camera, fine = SCENE.camera, 12
    offset = (np.arange(fine) + 0.5) / fine - 0.5
    for sphere, mask in zip(SCENE.spheres, RENDERING.truth.sphere_masks, strict=True):
        v, u = np.nonzero(_wider(mask, by=2))
        du, dv = (d.ravel() for d in np.meshgrid(offset, offset))
        u, v = u[:, None] + du, v[:, None] + dv
        rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(camera.K).T * [1, -1, -1]
        to_centre = np.array(sphere.centre_mm) - [0, 0, camera.working_distance_mm]
        miss = np.linalg.norm(np.cross(rays, to_centre), axis=-1) / np.linalg.norm(rays, axis=-1)
        expected = (miss < sphere.radius_mm).mean(axis=1)
        error = covered[_wider(mask, by=2)] - expected
        edge = (expected > 0) & (expected < 1)
        assert edge.sum() > 50
        assert np.abs(error).max() < 0.13
        assert np.abs(error[edge].mean()) < 0.02


def test_sphere_mirrors_the_board_and_the_dark():
    """One pixel near the rim sees the board, the middle sees the dark surroundings."""
    sphere = ChromeSphere((0.0, 0.0, 20.0), 20.0)
    led = np.array([200.0, 100.0, 390.0])
    scene = replace(
        SCENE,
        spheres=(sphere,),
        lights=Lights(positions_mm=led[None]),
        camera=scene_named("spheres", width=1281, height=1025).camera,
        board_radius_mm=1e4,
        ambient=0.0,
    )
    plane = render(scene).planes[0] / scene.electrons_per_us
    assert plane[512, 640] == pytest.approx(0.6 * scene.surroundings, rel=1e-5)
    pixel = np.array([640 + 80, 512 - 20])
    start, way = _mirrored(scene.camera, sphere, pixel)
    end = start - start[2] / way[2] * way
    toward = led - end
    r = np.linalg.norm(toward)
    expected = 0.6 * scene.board_albedo * (np.linalg.norm(led) / r) ** 2 * toward[2] / r
    assert way[2] < -0.3
    assert plane[pixel[1], pixel[0]] == pytest.approx(expected, rel=2e-3)
