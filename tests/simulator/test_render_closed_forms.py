"""Renderings, compared with closed forms that do not use the renderer's code."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import CameraModel, DataError, Lights
from simulator import ChromeSphere, Lens, Scene, bench_sensor, render, scene_named
from simulator.shapes import Coin, Even, Paint, Plane, Ripples, SphericalCap

WHITE = Even(1.0)
# No square pixels and no centred axis, so that exchanging x and y is detected.
CAMERA = CameraModel(np.array([[300.0, 0, 70.3], [0, 320.0, 41.8], [0, 0, 1]]), 150, 90, 500.0)
SKEWED = CameraModel(np.array([[300.0, 4.0, 70.3], [0, 320.0, 41.8], [0, 0, 1]]), 150, 90, 500.0)


def _scene(surface, lights, *, camera=CAMERA, **more):
    defaults = {"pattern": WHITE, "electrons_per_us": 1.0, "ambient": 0.0}
    return Scene(surface, lights, Lens(camera), bench_sensor(), **{**defaults, **more})


def _one_led(position, *, intensity=1.0, axis=None, mu=0.0):
    return Lights(
        positions_mm=np.array([position], float),
        intensities=np.array([intensity]),
        axes=None if axis is None else np.array([axis], float),
        mu=np.array([mu]),
    )


def _rays(camera):
    """Rays from the inverse of K; the renderer divides row by row."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.einsum("ij,hwj->hwi", np.linalg.inv(camera.K), np.stack([u, v, np.ones_like(u)], -1))
    return rays * [1, -1, -1]


def _reprojected(camera, points):
    seen = np.einsum(
        "ij,hwj->hwi", camera.K, (points - [0, 0, camera.working_distance_mm]) * [1, -1, -1]
    )
    return seen[..., :2] / seen[..., 2:]


def _on_cap(cap, camera):
    """First hit of each pixel's ray on the cap's sphere, by the quadratic formula."""
    rays = _rays(camera)
    centre = np.array([0, 0, cap.height_mm - cap.sphere_radius_mm])
    offset = np.array([0, 0, camera.working_distance_mm]) - centre
    a, b = (rays**2).sum(-1), (rays * offset).sum(-1)
    root = np.sqrt(np.clip(b * b - a * (offset @ offset - cap.sphere_radius_mm**2), 0, None))
    points = offset + centre + ((-b - root) / a)[..., None] * rays
    return points, (points - centre) / cap.sphere_radius_mm


@pytest.mark.parametrize(
    ("position", "mu", "axis"),
    [
        pytest.param((0, 0, 400), 0.0, None, id="above-isotropic"),
        pytest.param((0, 0, 400), 1.0, None, id="above-lambertian"),
        pytest.param((250, -120, 310), 2.5, None, id="aside-narrow"),
        pytest.param((-200, 150, 300), 1.0, (0.2, 0.1, -1), id="askew"),
    ],
)
def test_plane_under_one_led(position, mu, axis):
    scene = _scene(
        Plane(500.0), _one_led(position, intensity=1.7, mu=mu, axis=axis), pattern=Even(0.6)
    )
    rays = _rays(CAMERA)
    points = rays * 500.0 + [0, 0, 500.0]
    led = np.array(position, float)
    axis = -led / np.linalg.norm(led) if axis is None else np.array(axis) / np.linalg.norm(axis)

    def unscaled(p):
        way = led - p
        r = np.linalg.norm(way, axis=-1)
        return np.clip(-(way @ axis) / r, 0, None) ** mu / r**2, way / r[..., None]

    gain, toward = unscaled(points)
    # The intensity is the irradiance at the origin on a surface that faces the LED.
    expected = 0.6 * 1.7 * gain / unscaled(np.zeros(3))[0] * toward[..., 2]
    np.testing.assert_allclose(render(scene).planes[0], expected, rtol=1e-5)


def test_intensity_is_the_irradiance_at_the_origin():
    camera = CameraModel(np.array([[300.0, 0, 4], [0, 300.0, 4], [0, 0, 1]]), 9, 9, 500.0)
    led = np.array([240.0, 0, 320.0])
    # A plane that faces the LED.
    scene = _scene(Plane(500.0, 0.0, -0.75), _one_led(led, intensity=2.0, mu=1.3), camera=camera)
    assert render(scene).planes[0, 4, 4] == pytest.approx(2.0, rel=1e-6)


def test_cap_under_a_far_light():
    cap = SphericalCap(90.0, 30.0)
    direction = np.array([0.6, 0.0, 0.8])
    rendering = render(_scene(cap, _one_led(1e8 * direction)))
    _, normals = _on_cap(cap, CAMERA)
    mask = rendering.truth.mask
    expected = np.clip(normals @ direction, 0, None)
    np.testing.assert_allclose(rendering.planes[0][mask], expected[mask], rtol=1e-5, atol=1e-7)


def test_cap_truth_is_exact():
    cap = SphericalCap(90.0, 30.0)
    truth = render(_scene(cap, _one_led((0, 0, 450)))).truth
    points, normals = _on_cap(cap, CAMERA)
    assert truth.mask.sum() > 2000
    np.testing.assert_array_equal(truth.mask, np.hypot(points[..., 0], points[..., 1]) <= 90.0)
    np.testing.assert_allclose(truth.height_mm[truth.mask], points[truth.mask][:, 2], atol=1e-9)
    np.testing.assert_allclose(truth.normals[truth.mask], normals[truth.mask], atol=1e-7)
    np.testing.assert_allclose(
        truth.depth_mm + truth.height_mm, np.where(truth.mask, 500.0, np.nan)
    )


def test_outside_the_mask_the_truth_is_empty():
    truth = render(_scene(SphericalCap(30.0, 5.0), _one_led((0, 0, 450)))).truth
    assert not truth.mask.all()
    assert np.isnan(truth.height_mm[~truth.mask]).all()
    assert not truth.normals[~truth.mask].any()
    assert not truth.albedo[~truth.mask].any()


@pytest.mark.parametrize(
    "surface",
    [
        pytest.param(Plane(60.0, 5.0, 0.3, -0.2), id="tilted-plane"),
        pytest.param(SphericalCap(60.0, 25.0), id="cap"),
        pytest.param(Ripples(60.0, 0.5, 7.0), id="ripples"),
        pytest.param(Coin(60.0), id="coin"),
    ],
)
@pytest.mark.parametrize("camera", [CAMERA, SKEWED], ids=["plain", "skewed"])
def test_surface_points_are_on_their_pixel_rays(surface, camera):
    truth = render(_scene(surface, _one_led((0, 0, 450)), camera=camera)).truth
    points = _rays(camera) * truth.depth_mm[..., None] + [0, 0, 500.0]
    x, y = points[truth.mask][:, 0], points[truth.mask][:, 1]
    z, zx, zy = surface.evaluate(x, y)
    np.testing.assert_allclose(truth.height_mm[truth.mask], z, atol=1e-8)
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    on_surface = points.copy()
    on_surface[truth.mask, 2] = z
    pixels = _reprojected(camera, on_surface)
    np.testing.assert_allclose(pixels[truth.mask], np.stack([u, v], -1)[truth.mask], atol=1e-6)
    normals = np.stack([-zx, -zy, np.ones_like(z)], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    np.testing.assert_allclose(truth.normals[truth.mask], normals, atol=2e-7)


def test_orientation_of_the_image():
    truth = render(_scene(SphericalCap(90.0, 30.0), _one_led((0, 0, 450)))).truth
    assert truth.normals[10, 70, 1] > 0.05
    assert truth.normals[42, 110, 0] > 0.05


def test_attached_shadow_is_exact():
    cap = SphericalCap(90.0, 60.0)
    led = np.array([430.0, 60.0, 90.0])
    rendering = render(_scene(cap, _one_led(led)))
    points, normals = _on_cap(cap, CAMERA)
    facing = ((led - points) * normals).sum(-1)
    mask = rendering.truth.mask
    assert 0.05 < (facing[mask] < 0).mean() < 0.95
    np.testing.assert_array_equal(rendering.planes[0][mask] > 0, facing[mask] > 0)


def test_an_led_gives_no_light_behind_itself():
    scene = _scene(Plane(500.0), _one_led((40, 0, 20.0), axis=(-1, 0, 0)))
    points = _rays(CAMERA) * 500.0 + [0, 0, 500.0]
    np.testing.assert_array_equal(render(scene).planes[0] > 0, points[..., 0] < 40)


def test_radiance_is_linear_in_albedo_and_exposure_scale():
    lights = _one_led((200, 100, 380), mu=1.0)
    dim = render(_scene(Coin(60.0), lights, pattern=Paint(0.2, 0.4), board=Even(0.1)))
    bright = render(
        _scene(Coin(60.0), lights, pattern=Paint(0.4, 0.8), board=Even(0.2), electrons_per_us=3.0)
    )
    np.testing.assert_allclose(bright.planes, 6 * dim.planes, rtol=1e-5)
    mask = dim.truth.mask
    np.testing.assert_allclose(bright.truth.albedo[mask], 2 * dim.truth.albedo[mask], rtol=1e-6)


def test_albedo_follows_from_the_image():
    lights = _one_led((150, -100, 400))
    painted = render(_scene(Coin(60.0), lights, pattern=Paint(0.3, 0.7, 30.0)))
    white = render(_scene(Coin(60.0), lights))
    mask = painted.truth.mask
    ratio = painted.planes[0][mask] / white.planes[0][mask]
    np.testing.assert_allclose(painted.truth.albedo[mask], ratio, rtol=1e-5)


def test_sphere_casts_its_shadow_on_the_board():
    led, centre, radius = np.array([200.0, 90, 300]), np.array([-20.0, 10, 14]), 14.0
    scene = _scene(
        None,
        _one_led(led),
        board=Even(0.5),
        board_radius_mm=900.0,
        spheres=(ChromeSphere(tuple(centre), radius),),
    )
    rendering = render(scene)
    points = _rays(CAMERA) * 500.0 + [0, 0, 500.0]
    # Points in shadow are in the cone of LED and sphere, beyond the sphere.
    way, axis = points - led, centre - led
    angle = np.arctan2(np.linalg.norm(np.cross(way, axis), axis=-1), way @ axis)
    shadow = angle < np.arctan2(radius, np.sqrt(axis @ axis - radius**2))
    board = ~rendering.truth.sphere_masks[0]
    inner = board & ~_touching(rendering.truth.sphere_masks[0])
    assert shadow[inner].sum() > 100
    np.testing.assert_array_equal(rendering.planes[0][inner] == 0, shadow[inner])


def _touching(mask):
    wide = np.pad(mask, 2)
    h, w = mask.shape
    return np.any([wide[i : i + h, j : j + w] for i in range(5) for j in range(5)], axis=0)


def test_board_ends_at_its_edge():
    rendering = render(_scene(None, _one_led((0, 0, 400)), board=Even(0.5), board_radius_mm=50.0))
    points = _rays(CAMERA) * 500.0
    on_board = np.hypot(points[..., 0], points[..., 1]) <= 50.0
    np.testing.assert_array_equal(rendering.planes[0] > 0, on_board)


def test_planes_of_leds_and_of_ambient_light():
    rendering = render(scene_named("coin", width=64, height=48, leds=3, sharp=True))
    np.testing.assert_array_equal(rendering.plane(None), rendering.ambient)
    np.testing.assert_array_equal(rendering.plane(2), rendering.planes[2])
    mask = rendering.truth.mask
    expected = 0.002 * rendering.truth.electrons_per_us * rendering.truth.albedo
    np.testing.assert_allclose(rendering.ambient[mask], expected[mask], rtol=1e-6)
    with pytest.raises(DataError, match="LED 3 is not in the scene"):
        rendering.plane(3)


def test_the_same_seed_gives_the_same_bytes():
    first, again, other = (
        render(scene_named("coin-with-spheres", width=80, height=64, leds=3, seed=s)).planes
        for s in (7, 7, 8)
    )
    assert first.tobytes() == again.tobytes()
    assert first.tobytes() != other.tobytes()


def test_an_object_adds_only_its_reflections_to_the_spheres():
    scene = scene_named("coin-with-spheres", width=160, height=128, leds=2, sharp=True)
    with_coin, without = render(scene), render(replace(scene, body=None))
    spheres = with_coin.truth.sphere_masks.any(axis=0)
    # The coin is brighter than the velvet, so the spheres show it and are nowhere darker.
    assert (with_coin.planes - without.planes)[0][spheres].max() > 0.01
    assert (with_coin.planes - without.planes)[0][spheres].min() > -1e-6


def test_sphere_at_or_beyond_the_border_is_cut_off():
    lights = _one_led((0, 0, 400))
    places = {"beyond": (400.0, 0.0, 12.0), "at": (-117.0, 20.0, 12.0)}
    shown = {}
    for name, place in places.items():
        rendering = render(_scene(None, lights, spheres=(ChromeSphere(place, 12.0),)))
        assert np.isfinite(rendering.planes).all()
        shown[name] = rendering.truth.sphere_masks[0]
    assert not shown["beyond"].any()
    assert shown["at"][:, 0].any()
    assert not shown["at"][:, 20:].any()
