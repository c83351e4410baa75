"""Cast shadows, compared with closed forms and point-by-point search on exact surfaces."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.ndimage import maximum_filter, minimum_filter

from acquisition import CameraModel, Lights
from simulator import ChromeSphere, Lens, Scene, bench_sensor, render
from simulator.shapes import BandNoise, Coin, Even, MeshBody, Plane, Ripples, SphericalCap
from tests.quick_sample import quick

PERSPECTIVE = Lens(
    CameraModel(np.array([[420.0, 0, 101.0], [0, 430.0, 88.0], [0, 0, 1]]), 210, 170, 500.0)
)
PARALLEL = Lens.orthographic(210, 170, 1.2, 500.0)
LENSES = pytest.mark.parametrize(
    "lens", [pytest.param(PERSPECTIVE, id="perspective"), pytest.param(PARALLEL, id="parallel")]
)


def _scene(body, lights, lens=PERSPECTIVE, **more):
    defaults = {"board": Even(0.5), "board_radius_mm": 500.0, "ambient": 0.0}
    return Scene(body, lights, lens, bench_sensor(), 1.0, **{**defaults, **more})


def _leds(*positions):
    return Lights(positions_mm=np.array(positions, float))


def _board_points(lens):
    rows, columns = lens.size
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    if lens.camera is None:
        right, up = (x - (columns - 1) / 2) * lens.pixel_mm, ((rows - 1) / 2 - y) * lens.pixel_mm
        return np.stack([right, up, 0 * right], -1)
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(lens.camera.K).T * [1, -1, -1]
    return 500.0 * rays + [0, 0, 500.0]


def _off_by_more_than_a_pixel(result, expected, where):
    """Pixels that are wrong although all their neighbours should be alike."""
    alike = maximum_filter(expected, 3) == minimum_filter(expected, 3)
    return (result != expected) & alike & where


def _segment_gap(start, end):
    """Distance of the origin from line segments in the plane with the ends (..., 2)."""
    way = end - start
    t = np.clip(-(start * way).sum(-1) / (way**2).sum(-1), 0, 1)
    return np.linalg.norm(start + t[..., None] * way, axis=-1)


LOW_LEDS = [(300.0, 90, 60), (-200.0, 260, 90), (20.0, -350, 45), (-330.0, 0, 120)]


@LENSES
def test_step_casts_its_shadow_on_the_board(lens):
    """A round plateau: points are in shadow if the line to the LED passes the cylinder."""
    radius, height = 45.0, 7.0
    truth = render(_scene(Plane(radius, height), _leds(*LOW_LEDS), lens)).truth
    points = _board_points(lens)[..., :2]
    for led, result in zip(LOW_LEDS, truth.shadows, strict=True):
        below_the_top = points + height / led[2] * (np.array(led[:2]) - points)
        expected = _segment_gap(points, below_the_top) < radius
        outside = ~maximum_filter(truth.mask, 3) & (np.hypot(*np.moveaxis(points, -1, 0)) > radius)
        assert (expected & outside).sum() > 300
        assert not _off_by_more_than_a_pixel(result, expected, outside).any()


@LENSES
def test_hemisphere_casts_its_shadow_on_the_board(lens):
    radius = 40.0
    truth = render(_scene(SphericalCap(radius, radius), _leds(*LOW_LEDS), lens)).truth
    points = _board_points(lens)
    for led, result in zip(LOW_LEDS, truth.shadows, strict=True):
        way = np.array(led) - points
        t = np.clip(-(points * way).sum(-1) / (way**2).sum(-1), 0, 1)
        expected = np.linalg.norm(points + t[..., None] * way, axis=-1) < radius
        outside = ~maximum_filter(truth.mask, 3)
        assert (expected & outside).sum() > 300
        assert not _off_by_more_than_a_pixel(result, expected, outside).any()


@LENSES
def test_chrome_sphere_casts_its_shadow_on_a_plateau(lens):
    """The plane of the plateau, at z = 4, under a sphere next to it and above it."""
    centre, radius = np.array([95.0, 10.0, 40.0]), 14.0
    led = np.array([300.0, 20.0, 150.0])
    scene = _scene(
        Plane(60.0, 4.0), _leds(led), lens, spheres=(ChromeSphere(tuple(centre), radius),)
    )
    truth = render(scene).truth
    points = truth.points_mm
    way, axis = led - points, led - centre
    angle = np.arctan2(np.linalg.norm(np.cross(way, axis), axis=-1), (way * axis).sum(-1))
    expected = angle < np.arctan2(radius, np.sqrt(axis @ axis - radius**2))
    assert (expected & truth.mask).sum() > 100
    assert not ((truth.shadows[0] != expected) & truth.mask).any()


@pytest.mark.parametrize(
    "lights",
    [
        pytest.param(_leds((300, 0, 5), (-250, 250, 30), (0, 0, 400)), id="near"),
        pytest.param(Lights(np.array([[1, 0, 0.02], [-1, 1, 0.1], [0, 0, 1.0]])), id="distant"),
    ],
)
def test_flat_plane_has_no_shadow(lights):
    bare = render(_scene(None, lights)).truth
    assert not bare.shadows.any()
    plate = render(_scene(Plane(60.0, 2.0), lights)).truth
    assert not plate.shadows[:, plate.mask].any()


def test_tilted_plane_has_attached_shadow_only():
    lights = _leds((300, 0, 30.0), (-300, 0, 40.0), (0, 300, 30.0))
    truth = render(_scene(Plane(50.0, 20.0, 0.3, -0.1), lights)).truth
    facing = (np.array(lights.positions_mm) @ [-0.3, 0.1, 1.0]) > 20.0
    assert facing.tolist() == [False, True, True]
    for shadow, lit in zip(truth.shadows, facing, strict=True):
        np.testing.assert_array_equal(shadow[truth.mask], not lit)


@pytest.mark.parametrize("height", [5.0, 20.0, 45.0])
def test_convex_cap_has_only_attached_shadow(height):
    leds = [(120.0, 10, 30), (-300, 200, 80), (0, 0, 300), (90, -90, 55)]
    truth = render(_scene(SphericalCap(50.0, height), _leds(*leds))).truth
    sphere = (50.0**2 + height**2) / (2 * height)
    normals = (truth.points_mm - [0, 0, height - sphere]) / sphere
    for led, result in zip(leds, truth.shadows, strict=True):
        facing = ((np.array(led, float) - truth.points_mm) * normals).sum(-1)
        clear = truth.mask & (np.abs(facing) > 1e-9)
        np.testing.assert_array_equal(result[clear], facing[clear] <= 0)


def _searched(body, points, led, fine=500):
    """Whether the exact surface blocks the line to the LED."""
    way = led - points
    reach = np.minimum(1.0, (body.top_mm - points[:, 2]) / way[:, 2])
    reach = np.minimum(reach, 2 * body.radius_mm / np.hypot(way[:, 0], way[:, 1]))
    share = reach[:, None] * (np.arange(fine) + 0.5) / fine
    x, y, z = (points[:, axis, None] + share * way[:, axis, None] for axis in range(3))
    return np.any((body.evaluate(x, y)[0] > z + 1e-9) & body.inside(x, y), axis=1)


@pytest.mark.parametrize(
    ("body", "led"),
    quick(
        [
            pytest.param(Ripples(60.0, 1.2, 12.0), (260.0, 120, 60), id="ripples"),
            pytest.param(BandNoise(60.0, 0.8, 9.0, 4.0, seed=5), (-250.0, 150, 70), id="noise"),
            pytest.param(Coin(60.0, dome_mm=6.0, relief_mm=1.5), (180.0, -240, 60), id="coin"),
            pytest.param(Ripples(60.0, 1.2, 12.0), (30.0, 20, 12), id="led-close-by"),
        ],
        every=4,
    ),
)
def test_relief_shadows_itself_like_the_exact_surface(body, led):
    lens = Lens.orthographic(90, 70, 0.5, 500.0)
    # It faces down: an LED gives no light behind its own plane.
    lights = replace(_leds(led), axes=np.array([[0.0, 0.0, -1.0]]))
    truth = render(_scene(body, lights, lens)).truth
    points = truth.points_mm
    ask = ((np.array(led) - points) * truth.normals).sum(-1) > 0
    assert truth.mask.all()
    expected = np.ones(truth.size, bool)
    expected[ask] = _searched(body, points[ask], np.array(led))
    result = truth.shadows[0]
    cast = expected & ask
    assert cast.sum() > 150
    # A lit streak narrower than a pixel may end one pixel too late.
    assert _off_by_more_than_a_pixel(result, expected, ask).sum() <= 2
    # Points that are lit by the exact surface are never dark, even next to an edge.
    assert not (result & ~expected).any()
    assert (result & cast).sum() > 0.9 * cast.sum()


def test_dark_points_receive_no_light():
    rendering = render(_scene(Coin(60.0, relief_mm=1.5), _leds(*LOW_LEDS)))
    np.testing.assert_array_equal(rendering.planes == 0, rendering.truth.shadows)


def test_shadows_can_be_turned_off():
    lit = render(_scene(SphericalCap(40.0, 40.0), _leds(*LOW_LEDS), shadows=False)).truth
    assert not lit.shadows[:, ~lit.mask].any()
    assert lit.shadows[:, lit.mask].any()


def test_length_of_the_shadow_of_a_distant_light():
    direction = np.array([0.8, 0.0, 0.2])
    body = Plane(50.0, 6.0, outline="square")
    truth = render(_scene(body, Lights(direction[None]), PARALLEL)).truth
    x, y, _ = np.moveaxis(_board_points(PARALLEL), -1, 0)
    half, length = 50.0 / np.sqrt(2), 6.0 * 0.8 / 0.2
    expected = (x > -half - length) & (x < -half) & (np.abs(y) < half)
    row = truth.size[0] // 2
    outside = ~maximum_filter(truth.mask, 3)
    assert truth.shadows[0, row].any()
    assert not _off_by_more_than_a_pixel(truth.shadows[0], expected, outside).any()


def test_penumbra_of_a_straight_edge():
    """The disc of an LED that faces down, partly hidden by the upper edge of a wall."""
    radius, height, half = 30.0, 60.0, 60.0 / np.sqrt(2)
    led, strip = np.array([200.0, 0.0, 250.0]), Lens.orthographic(210, 3, 1.2, 500.0)
    lights = Lights(positions_mm=led[None], axes=np.array([[0, 0, -1.0]]))
    scene = _scene(
        Plane(60.0, height, outline="square"),
        lights,
        strip,
        led_radius_mm=radius,
        soft_shadow_samples=400,
    )
    soft, free = (
        render(replace(scene, shadows=on)).planes[0, 1].astype(float) for on in (True, False)
    )
    x = _board_points(strip)[1, :, 0]
    # The line from a point over the edge reaches the plane of the disc here; beyond, it is hidden.
    over_edge = x + (-half - x) * led[2] / height
    cut = np.clip((over_edge - led[0]) / radius, -1, 1)
    expected = 0.5 + (np.arcsin(cut) + cut * np.sqrt(1 - cut**2)) / np.pi
    left = x < -half - 1.0
    assert ((expected > 0.05) & (expected < 0.95) & left).sum() > 10
    np.testing.assert_allclose((soft / free)[left], expected[left], atol=0.03)


def _ball(radius, centre):
    ball = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    return MeshBody(np.asarray(ball.vertices) + centre, np.asarray(ball.faces))


def test_mesh_of_a_ball_casts_the_shadow_of_a_sphere():
    radius, centre = 15.0, np.array([5.0, -8.0, 17.0])
    truth = render(_scene(_ball(radius, centre), _leds(*LOW_LEDS))).truth
    points = _board_points(PERSPECTIVE)
    for led, result in zip(LOW_LEDS, truth.shadows, strict=True):
        way, axis = points - led, centre - led
        angle = np.arctan2(np.linalg.norm(np.cross(way, axis), axis=-1), way @ axis)
        expected = angle < np.arctan2(radius, np.sqrt(axis @ axis - radius**2))
        # The part of the board behind the ball, seen from the LED.
        expected &= (way**2).sum(-1) > axis @ axis - radius**2
        outside = ~maximum_filter(truth.mask, 3)
        assert (expected & outside).sum() > 100
        assert not _off_by_more_than_a_pixel(result, expected, outside).any()


def test_mesh_shadows_itself_where_it_faces_away():
    truth = render(_scene(_ball(30.0, np.array([0.0, 0.0, 30.0])), _leds(*LOW_LEDS))).truth
    for led, result in zip(LOW_LEDS, truth.shadows, strict=True):
        facing = ((np.array(led) - truth.points_mm) * truth.normals).sum(-1)
        distance = np.linalg.norm(np.array(led) - truth.points_mm, axis=-1)
        # Facets are flat: their horizon differs by about a degree from the smooth one.
        clear = truth.mask & (np.abs(facing) > 0.04 * distance)
        np.testing.assert_array_equal(result[clear], facing[clear] < 0)


@pytest.mark.slow
def test_box_mesh_casts_the_shadow_of_a_step():
    box = trimesh.creation.box((80.0, 60.0, 7.0))
    body = MeshBody(np.add(box.vertices, [0, 0, 3.5]), np.asarray(box.faces), smooth=False)
    truth = render(_scene(body, _leds(*LOW_LEDS), PARALLEL)).truth
    points = _board_points(PARALLEL)[..., :2]
    assert not truth.shadows[:, minimum_filter(truth.mask, 3)].any()
    for led, result in zip(LOW_LEDS, truth.shadows, strict=True):
        share = np.linspace(0, 7.0 / led[2], 200)
        ways = points[..., None, :] + share[:, None] * (np.array(led[:2]) - points)[..., None, :]
        expected = np.any((np.abs(ways[..., 0]) < 40) & (np.abs(ways[..., 1]) < 30), axis=-1)
        outside = ~maximum_filter(truth.mask, 3)
        assert (expected & outside).sum() > 200
        assert not _off_by_more_than_a_pixel(result, expected, outside).any()
