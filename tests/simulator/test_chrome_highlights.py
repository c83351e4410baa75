"""Mirrored LEDs: position, energy and width, compared with the law of reflection and ray counts."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import CameraModel, Lights
from simulator import ChromeSphere, Lens, bench_camera, dome_lights, render, scene_named
from simulator.rendering import MirroredLights, find_mirrored_lights
from simulator.rendering.chrome import draw_mirrored_lights, mirror_points
from simulator.rendering.shadow import Occluders
from simulator.shapes import Even, SphericalCap
from tests.quick_sample import quick

LENS = Lens(bench_camera())  # its eye is at (0, 0, 600)
EYE = np.array([0.0, 0.0, 600.0])
SCENE = scene_named("spheres", width=320, height=256, seed=11, sharp=True)


@cache
def _rendering():
    return render(SCENE)


def _pairs(scene):
    for s, sphere in enumerate(scene.spheres):
        for n in range(len(scene.lights)):
            yield s, n, sphere, scene.lights.positions_mm[n]


def test_every_led_is_mirrored_in_every_sphere():
    assert np.isfinite(_rendering().truth.highlights_px).all()


@settings(max_examples=60)
@given(
    place=st.tuples(st.floats(-150, 150), st.floats(-150, 150), st.floats(0, 50)),
    radius=st.floats(1, 30),
    led=st.tuples(st.floats(-500, 500), st.floats(-500, 500), st.floats(120, 600)),
)
def test_mirror_point_obeys_the_law_of_reflection(place, radius, led):
    sphere, led = ChromeSphere(place, radius), np.array(led)
    points, visible = mirror_points(LENS, sphere, led[None], near=True)
    assert visible[0]
    normal = (points[0] - place) / radius
    assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-9)
    to_eye, to_led = EYE - points[0], led - points[0]
    half = to_eye / np.linalg.norm(to_eye) + to_led / np.linalg.norm(to_led)
    # The bisector of both directions is the normal, on the outer side.
    np.testing.assert_allclose(half / np.linalg.norm(half), normal, atol=1e-9)


def test_led_on_the_line_of_sight_is_mirrored_at_the_centre():
    sphere = ChromeSphere((40.0, -30.0, 15.0), 15.0)
    led = EYE + 0.4 * (np.array(sphere.centre_mm) - EYE)
    points, visible = mirror_points(LENS, sphere, led[None], near=True)
    toward = (EYE - sphere.centre_mm) / np.linalg.norm(EYE - sphere.centre_mm)
    assert visible[0]
    np.testing.assert_allclose(points[0], sphere.centre_mm + 15.0 * toward, atol=1e-9)


def test_led_behind_the_sphere_is_not_seen():
    sphere, leds = (
        ChromeSphere((0, 0, 100.0), 50.0),
        np.array([[0.0, 0.1, 20.0], [300.0, 0, 300.0]]),
    )
    _, visible = mirror_points(LENS, sphere, leds, near=True)
    assert visible.tolist() == [False, True]


def test_another_sphere_hides_the_highlight():
    low = Lights(positions_mm=np.array([[300.0, 0, 30.0], [-300.0, 0, 300.0]]))
    pair = (ChromeSphere((-60.0, 0, 20.0), 20.0), ChromeSphere((40.0, 0, 20.0), 20.0))
    seen = np.isfinite(find_mirrored_lights(replace(SCENE, lights=low, spheres=pair)).signal)
    assert seen.tolist() == [[False, True], [True, True]]


def test_a_light_on_the_right_is_mirrored_right_of_the_centre():
    lights = Lights(positions_mm=np.array([[300.0, 0, 300.0], [0.0, 300, 300]]))
    sphere = (ChromeSphere((0, 0, 20.0), 20.0),)
    x, y = find_mirrored_lights(replace(SCENE, lights=lights, spheres=sphere)).pixels[0].T
    centre_x, centre_y = SCENE.camera.K[0, 2], SCENE.camera.K[1, 2]
    assert x[0] > centre_x + 5
    assert y[0] == pytest.approx(centre_y)
    assert y[1] < centre_y - 5
    assert x[1] == pytest.approx(centre_x)


def _spot(plane, pixel, reach=6):
    """Centroid and sum of the pixels of a highlight that are brighter than matte surfaces."""
    x0, y0 = np.round(pixel).astype(int)
    window = plane[y0 - reach : y0 + reach + 1, x0 - reach : x0 + reach + 1].astype(float)
    y, x = np.mgrid[y0 - reach : y0 + reach + 1, x0 - reach : x0 + reach + 1]
    spot = np.clip(window - 0.5 * SCENE.electrons_per_us, 0, None)
    return np.array([(spot * x).sum(), (spot * y).sum()]) / spot.sum(), spot.sum()


def test_rendered_highlight_is_at_its_true_position():
    worst = max(
        np.abs(
            _spot(_rendering().planes[n], _rendering().truth.highlights_px[s, n])[0]
            - _rendering().truth.highlights_px[s, n]
        ).max()
        for s, n, _, _ in _pairs(SCENE)
    )
    assert worst < 0.02


def test_rendered_highlight_has_its_energy():
    dark = replace(SCENE, board=Even(0.0), surroundings=0.0, ambient=0.0)
    signal = find_mirrored_lights(dark).signal * dark.electrons_per_us
    planes = render(dark).planes
    for s, mask in enumerate(_rendering().truth.sphere_masks):
        total = planes[:, _wider(mask)].sum(axis=1)
        np.testing.assert_allclose(total, signal[s], rtol=1e-4)


def _wider(mask, by=6):
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    wide = np.zeros_like(mask)
    wide[rows[0] - by : rows[-1] + by, columns[0] - by : columns[-1] + by] = True
    return wide


FAR_CAMERA = bench_camera(640, 512)
DISTORTED = CameraModel(FAR_CAMERA.K, 640, 512, 600.0, np.array([-0.9, 0.3, 0.01, -0.02, 0.0]))
LENSES = [
    pytest.param(Lens(FAR_CAMERA), id="pinhole"),
    pytest.param(Lens(DISTORTED), id="distorted"),
    pytest.param(Lens.orthographic(640, 512, 0.458, 600.0), id="orthographic"),
]


def _bench(lens, **more):
    """Four spheres in full view under nine LEDs."""
    aside = [(-92.0, 58.0, 20.0), (84.0, 66.0, 16.0), (-70.0, -62.0, 14.0), (116.0, -84.0, 20.0)]
    spheres = tuple(ChromeSphere(place, place[2]) for place in aside)
    scene = replace(SCENE, lens=lens, lights=dome_lights(9, seed=3), spheres=spheres)
    return replace(scene, **more)


def _opencv_rays(lens, pixels):
    """Origins and unit rays by OpenCV, or in closed form for the orthographic lens."""
    if lens.camera is None:
        rows, columns = lens.size
        flat = (pixels - [(columns - 1) / 2, (rows - 1) / 2]) * [lens.pixel_mm, -lens.pixel_mm]
        origins = np.column_stack([flat, np.full(len(flat), lens.height_mm)])
        return origins, np.tile([0.0, 0, -1], (len(pixels), 1))
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-13)
    flat = cv2.undistortPoints(
        pixels[:, None], lens.camera.K, lens.camera.distortion, criteria=stop
    )[:, 0]
    rays = np.column_stack([flat, np.ones(len(flat))]) * [1, -1, -1]
    return np.tile([0, 0, 600.0], (len(rays), 1)), rays / np.linalg.norm(rays, axis=1)[:, None]


def _reflected(lens, sphere, pixels):
    """Start and direction of rays of pixels after their reflection, by the quadratic formula."""
    origins, rays = _opencv_rays(lens, pixels)
    offset = origins - sphere.centre_mm
    b = (rays * offset).sum(axis=1)
    t = -b - np.sqrt(b * b - (offset**2).sum(axis=1) + sphere.radius_mm**2)
    start = origins + t[:, None] * rays
    normal = (start - sphere.centre_mm) / sphere.radius_mm
    return start, rays - 2 * (rays * normal).sum(axis=1)[:, None] * normal


@pytest.mark.parametrize("lens", [*LENSES, pytest.param(None, id="rendered")])
def test_ray_of_the_highlight_hits_the_led_with_every_lens(lens):
    bench = _bench(lens) if lens else SCENE
    result = find_mirrored_lights(bench).pixels if lens else _rendering().truth.highlights_px
    for sphere, pixels in zip(bench.spheres, result, strict=True):
        start, way = _reflected(bench.lens, sphere, pixels)
        toward = bench.lights.positions_mm - start
        assert np.linalg.norm(np.cross(toward, way), axis=1).max() < 1e-6
        assert (toward * way).sum(axis=1).min() > 0


@pytest.mark.parametrize("lens", quick(LENSES, every=2))
@pytest.mark.parametrize(
    ("turn", "mu", "radius"),
    [
        pytest.param((0.0, 0.0, 0.0), 1.0, 2.0, id="lambertian"),
        pytest.param((0.5, -0.4, 0.2), 3.0, 12.0, id="narrow-and-askew"),
        pytest.param((0.0, 0.3, 0.2), 1.0, 40.0, id="wide"),
    ],
)
def test_energy_and_centroid_agree_with_counting_rays(lens, turn, mu, radius):
    """Trace a fine grid of rays and add the weights of those that hit the luminous disc."""
    dome = dome_lights(9, seed=3)
    lights = replace(dome, axes=dome.axes + turn, mu=np.full(9, mu))
    bench = _bench(lens, lights=lights, led_radius_mm=radius)
    result, fine = find_mirrored_lights(bench), 120
    for s, n in ((0, 5), (3, 0), (3, 7)):
        sphere, led, axis = bench.spheres[s], lights.positions_mm[n], lights.axes[n]
        spots = result.spots[s, n]
        middle, half = spots.mean(axis=0), 0.8 * np.ptp(spots, axis=0).max()
        step = half * ((np.arange(2 * fine) + 0.5) / fine - 1)
        pixels = middle + np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2)
        start, way = _reflected(lens, sphere, pixels)
        end = start + (((led - start) @ axis) / (way @ axis))[:, None] * way
        weight = np.where(np.linalg.norm(end - led, axis=1) < radius, -(way @ axis), 0.0)
        weight[weight > 0] **= mu - 1
        assert np.count_nonzero(weight) > 5000
        # A disc of radiance L cos^(mu-1) gives E = L pi a^2 cos^mu / r^2; white has E / pi.
        squared = led @ led
        at_origin = (-(led @ axis) / np.sqrt(squared)) ** mu
        radiance = bench.irradiance[n] * squared / at_origin / (np.pi * radius**2)
        expected = np.pi * sphere.reflectance * radiance * weight.sum() * (half / fine) ** 2
        assert result.signal[s, n] == pytest.approx(expected, rel=2e-3)
        drawn = np.average(spots, axis=0, weights=result.shares[s, n])
        np.testing.assert_allclose(
            drawn, np.average(pixels, axis=0, weights=weight), atol=0.003 * max(half, 1)
        )


@pytest.mark.parametrize("lens", LENSES)
def test_drawn_centroid_is_at_the_mirror_point_with_every_lens(lens):
    bench = _bench(lens)
    result, planes = find_mirrored_lights(bench), np.zeros((9, *lens.size), np.float32)
    draw_mirrored_lights(bench, result, planes)
    y, x = np.mgrid[: lens.size[0], : lens.size[1]]
    for s, sphere in enumerate(bench.spheres):
        window = lens.window(sphere.centre_mm, sphere.radius_mm)
        for n, plane in enumerate(planes):
            spot = plane[window].astype(float)
            place = [(spot * v[window]).sum() / spot.sum() for v in (x, y)]
            np.testing.assert_allclose(place, result.pixels[s, n], atol=0.02)
            assert spot.sum() == pytest.approx(result.signal[s, n], rel=1e-4)


@pytest.mark.parametrize("lens", quick(LENSES[1:], every=2))
def test_rendered_highlight_is_at_the_mirror_point_with_every_lens(lens):
    """The complete image, with board and neighbouring spheres mirrored around the highlights."""
    scene = _bench(lens)
    rendering = render(scene)
    for n, plane in enumerate(rendering.planes):
        for place in rendering.truth.highlights_px[:, n]:
            np.testing.assert_allclose(_spot(plane, place)[0], place, atol=0.02)


def test_orthographic_view_of_distant_lights_in_closed_form():
    """The normal bisects view and light; a mirror ball scatters uniformly in all directions.

    Each highlight therefore has pi E rho R^2 / 4 of area, independent of its position.
    """
    directions = np.array([[0.0, 0, 1], [0.3, -0.5, 0.6], [-0.9, 0.1, 0.1], [0.5, 0.5, 0.05]])
    lights = Lights(directions=directions, intensities=np.array([1.0, 2, 3, 4]))
    sphere = ChromeSphere((12.0, -7.0, 30.0), 25.0, reflectance=0.7)
    result = find_mirrored_lights(
        _bench(Lens.orthographic(401, 301, 0.25, 99.0), lights=lights, spheres=(sphere,))
    )
    half = lights.directions + np.array([0, 0, 1])
    half /= np.linalg.norm(half, axis=1)[:, None]
    pixels = (half[:, :2] * 25 + [12, -7]) / [0.25, -0.25] + [200, 150]
    np.testing.assert_allclose(result.pixels[0], pixels, atol=1e-9)
    expected = np.pi * lights.intensities[:, 0] * 0.7 * (25 / 0.25) ** 2 / 4
    np.testing.assert_allclose(result.signal[0], expected, rtol=1e-6)


def test_distant_lights_are_the_limit_of_far_leds():
    lens, directions = Lens(DISTORTED), dome_lights(9, seed=3).unit_directions
    distant = find_mirrored_lights(_bench(lens, lights=Lights(directions=directions)))
    far = find_mirrored_lights(_bench(lens, lights=Lights(positions_mm=1e7 * directions)))
    np.testing.assert_allclose(distant.pixels, far.pixels, atol=1e-3)
    np.testing.assert_allclose(distant.signal, far.signal, rtol=1e-4)


def test_bayer_pixels_use_the_intensity_of_their_channel():
    lights = Lights(positions_mm=np.array([[100.0, 50, 400]]), intensities=np.array([[3.0, 2, 1]]))
    grey, mosaic = (Lens(FAR_CAMERA, cfa=cfa, psf_sigma_px=3.0) for cfa in (None, "GRBG"))
    planes = np.zeros((2, 1, *grey.size), np.float32)
    for plane, lens in zip(planes, (grey, mosaic), strict=True):
        bench = _bench(lens, lights=lights)
        draw_mirrored_lights(bench, find_mirrored_lights(bench), plane)
    seen = planes[0, 0] > 1e-3 * planes[0].max()
    ratio = np.where(seen, planes[1, 0] / np.where(seen, planes[0, 0], 1), np.nan)
    assert seen.sum() > 400
    for row, column, gain in ((0, 0, 1.0), (0, 1, 1.5), (1, 0, 0.5), (1, 1, 1.0)):
        values = ratio[row::2, column::2]
        np.testing.assert_allclose(values[np.isfinite(values)], gain, rtol=1e-5)


def test_a_hill_hides_the_highlights_of_the_leds_behind_it():
    """The line from mirror point to LED passes the ball of which the hill is a cap."""
    hill = SphericalCap(70.0, 45.0)
    ball = (70.0**2 + 45.0**2) / (2 * 45.0)
    turn = np.arange(16) * 2 * np.pi / 16
    low = np.stack([440 * np.cos(turn), 440 * np.sin(turn), np.full(16, 75.0)], axis=1)
    sphere = ChromeSphere((95.0, 0.0, 12.0), 12.0)
    scene = replace(
        SCENE, body=hill, spheres=(sphere,), lights=Lights(positions_mm=low), led_radius_mm=1e-3
    )
    free = find_mirrored_lights(scene)
    result = find_mirrored_lights(scene, Occluders(scene.sphere_table, hill.shadow_caster(0.2)))
    points, _ = mirror_points(scene.lens, sphere, low, near=True)
    way = (low - points) / np.linalg.norm(low - points, axis=1)[:, None]
    to_middle = np.array([0, 0, 45.0 - ball]) - points
    along = (to_middle * way).sum(axis=1)
    past = np.linalg.norm(to_middle - along[:, None] * way, axis=1) - ball
    assert np.abs(past).min() > 0.5
    hidden = (past < 0) & (along > 0)
    assert 3 <= hidden.sum() <= 13
    np.testing.assert_array_equal(np.isnan(result.signal[0]), hidden | np.isnan(free.signal[0]))
    np.testing.assert_array_equal(result.pixels[0, ~hidden], free.pixels[0, ~hidden])


def test_a_highlight_that_the_distortion_folds_into_the_image_is_omitted():
    """A ball far outside the field, which Brown's polynomial folds back into the image."""
    lens = Lens(CameraModel(FAR_CAMERA.K, 640, 512, 600.0, np.array([-1.5, 0, 0, 0, 0])))
    # r - 1.5 r^3 is 0 at r = 0.816, and so would be the distance from the image's centre.
    away = ChromeSphere((0.816 * 560.0, 0.0, 40.0), 5.0)
    lights = Lights(positions_mm=np.array([[300.0, 50, 400]]))
    bench = _bench(lens, lights=lights, spheres=(away,))
    place = lens.project(np.array([away.centre_mm]))[0]
    assert 100 < place[0] < 540
    planes = np.zeros((1, *lens.size), np.float32)
    draw_mirrored_lights(bench, find_mirrored_lights(bench), planes)
    assert np.isnan(find_mirrored_lights(bench).signal).all()
    assert not planes.any()


def test_energy_depends_on_the_radiance_and_hardly_on_the_disc():
    base = find_mirrored_lights(SCENE)
    lights = replace(SCENE.lights, intensities=2 * SCENE.lights.intensities)
    brighter = find_mirrored_lights(replace(SCENE, lights=lights))
    wider = find_mirrored_lights(replace(SCENE, led_radius_mm=20.0))
    np.testing.assert_allclose(brighter.signal, 2 * base.signal, rtol=1e-12)
    # The effect is of second order in the angle of the disc, (20 / 450)^2.
    np.testing.assert_allclose(wider.signal, base.signal, rtol=4e-3)


def test_energy_in_pixels_is_proportional_to_the_square_of_the_resolution():
    scene = scene_named("spheres", width=1280, height=1024, seed=11, sharp=True)
    fine = find_mirrored_lights(scene)
    np.testing.assert_allclose(fine.signal, 16 * find_mirrored_lights(SCENE).signal, rtol=1e-4)


def _drawn_spot(x, y, sigma):
    """Draw a mirrored light whose signal is 5."""
    one = replace(SCENE, lights=Lights(positions_mm=np.array([[0.0, 0, 400]])))
    spot, none = np.array([[[[x, y]]]]), np.zeros((1, 1))
    plane = np.zeros((1, 30, 40), np.float32)
    lights = MirroredLights(spot[..., 0, :], none + 5, spot, none[..., None] + 5, sigma, none)
    draw_mirrored_lights(one, lights, plane)
    return plane[0]


@pytest.mark.parametrize(
    ("x", "y", "sigma"),
    [(20.0, 14.0, 0.7), (20.37, 14.81, 0.7), (20.5, 14.5, 1.9)],
)
def test_a_spot_has_its_sum_position_and_width(x, y, sigma):
    plane = _drawn_spot(x, y, sigma)
    rows, columns = np.mgrid[:30, :40]
    assert plane.sum() == pytest.approx(5.0, rel=1e-5)
    at_x, at_y = (plane * columns).sum() / plane.sum(), (plane * rows).sum() / plane.sum()
    assert (at_x, at_y) == pytest.approx((x, y), abs=1e-4)
    variance = (plane * (columns - x) ** 2).sum() / plane.sum()
    assert variance == pytest.approx(sigma**2 + 1 / 12, rel=0.1)


@pytest.mark.parametrize(("x", "y"), [(-0.4, 5.0), (39.4, 29.3), (-50.0, 5.0), (5.0, 200.0)])
def test_a_spot_at_the_border_is_drawn_only_inside(x, y):
    plane = _drawn_spot(x, y, 0.7)
    assert 0 <= plane.sum() < 5.0
    assert np.isfinite(plane).all()


def test_sphere_masks_equal_the_cone_of_tangents():
    camera = SCENE.camera
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(camera.K).T * [1, -1, -1]
    for sphere, mask in zip(SCENE.spheres, _rendering().truth.sphere_masks, strict=True):
        to_centre = np.array(sphere.centre_mm) - [0, 0, camera.working_distance_mm]
        miss = np.linalg.norm(np.cross(rays, to_centre), axis=-1) / np.linalg.norm(rays, axis=-1)
        np.testing.assert_array_equal(mask, miss < sphere.radius_mm)


def test_outline_is_antialiased():
    black = replace(
        SCENE,
        spheres=tuple(replace(s, reflectance=0.0) for s in SCENE.spheres),
        surroundings=0.0,
        ambient=1.0,
    )
    level = black.board.albedo * black.electrons_per_us
    covered = 1 - render(black).ambient / level
    camera, fine = SCENE.camera, 12
    offset = (np.arange(fine) + 0.5) / fine - 0.5
    for sphere, mask in zip(SCENE.spheres, _rendering().truth.sphere_masks, strict=True):
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
        lens=scene_named("spheres", width=1281, height=1025, sharp=True).lens,
        board_radius_mm=1e4,
        ambient=0.0,
    )
    plane = render(scene).planes[0] / scene.electrons_per_us
    assert plane[512, 640] == pytest.approx(0.6 * scene.surroundings, rel=1e-5)
    pixel = np.array([640 + 80, 512 - 20])
    start, way = (part[0] for part in _reflected(scene.lens, sphere, pixel[None].astype(float)))
    end = start - start[2] / way[2] * way
    toward = led - end
    r = np.linalg.norm(toward)
    expected = 0.6 * scene.board.albedo * (np.linalg.norm(led) / r) ** 2 * toward[2] / r
    assert way[2] < -0.3
    assert plane[pixel[1], pixel[0]] == pytest.approx(expected, rel=2e-3)
