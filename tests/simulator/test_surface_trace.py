"""Rays against height fields: brute force, closed forms, and surfaces that hide themselves."""

import math

import numpy as np
import pytest

from acquisition import DataError
from simulator.shapes import (
    BandNoise,
    Coin,
    CrackedLeather,
    Plane,
    Ripples,
    SphericalCap,
    StepGauge,
    Surface,
)
from simulator.shapes.field_trace import FieldBounds, meet_field
from tests.quick_sample import quick

ABOVE = np.array([0.0, 0.0, 600.0])


def _fan(count, seed=0, reach=0.17):
    """Rays of a camera 600 mm above the origin."""
    aim = np.random.default_rng(seed).uniform(-reach, reach, (count, 2))
    return np.column_stack([aim, np.full(count, -1.0)])


def _slanting(count, seed=0, height=200.0):
    """Rays from all sides that descend at 20 to 70 degrees and pass near the origin."""
    rng = np.random.default_rng(seed)
    around, down = rng.uniform(0, 2 * np.pi, count), np.radians(rng.uniform(20, 70, count))
    level = np.stack([np.cos(around), np.sin(around)], axis=1) * np.cos(down)[:, None]
    way = np.column_stack([level, -np.sin(down)])
    aim = np.column_stack([rng.uniform(-35, 35, (count, 2)), np.zeros(count)])
    return aim - way * (height / np.sin(down))[:, None], way


def _first_by_brute_force(surface, origins, directions, samples=8001):
    """Sample each ray densely between the heights of the field and take the first crossing."""
    top, bottom = surface.bounds.top_mm + 0.1, surface.bounds.bottom_mm - 0.1
    result = np.full(len(origins), np.nan)
    for i, (start, way) in enumerate(zip(origins, directions, strict=True)):
        t = np.linspace((top - start[2]) / way[2], (bottom - start[2]) / way[2], samples)
        x, y, z = (start[a] + t * way[a] for a in range(3))
        within = surface.inside(x, y)
        gap = np.where(within, z - surface.evaluate(x, y)[0], np.nan)
        entry = np.flatnonzero(within)[:1]
        # The ray enters through the wall: there is no hit.
        if entry.size and gap[entry[0]] < 0:
            continue
        crossing = np.flatnonzero((gap[:-1] >= 0) & (gap[1:] < 0))
        if crossing.size:
            k = crossing[0]
            result[i] = t[k] + (t[k + 1] - t[k]) * gap[k] / (gap[k] - gap[k + 1])
    return result


class _Slope(Surface):
    """A plane that rises towards a corner of the square around the outline."""

    def evaluate(self, x_mm, y_mm):
        return x_mm + y_mm, np.ones_like(x_mm), np.ones_like(x_mm)


def test_bounds_are_those_within_the_outline():
    bounds = _Slope(60.0).bounds
    highest = 60.0 * math.sqrt(2)
    assert highest <= bounds.top_mm < 115  # 120 in the corners
    assert -115 < bounds.bottom_mm <= -highest


STEEP = [
    pytest.param(Coin(60.0, seed=1), id="coin"),
    pytest.param(Coin(60.0, relief_mm=6.0, seed=1), id="deep-coin"),
    pytest.param(Ripples(60.0, 6.0, 9.0), id="deep-ripples"),
    pytest.param(BandNoise(60.0, 1.5, 6.0, height_mm=9.0, seed=3), id="rough"),
    pytest.param(CrackedLeather(60.0, 4.0, seed=1), id="leather"),
    pytest.param(StepGauge(60.0, (6.0, 1.0, 9.0, 3.0), edge_mm=0.05), id="upright-steps"),
    pytest.param(SphericalCap(50.0, 50.0), id="half-sphere"),
]


@pytest.mark.parametrize("surface", quick(STEEP, every=8))
@pytest.mark.parametrize("slanting", [False, True], ids=["camera", "slanting"])
def test_first_hit_equals_that_of_brute_force(surface, slanting):
    origins, directions = (
        _slanting(80) if slanting else (np.tile(ABOVE, (80, 1)), _fan(80, reach=0.09))
    )
    hits = surface.trace(origins, directions)
    expected = _first_by_brute_force(surface, origins, directions)
    assert np.isfinite(expected).sum() > 40
    np.testing.assert_array_equal(hits.hit, np.isfinite(expected))
    points = origins + expected[:, None] * directions
    seen = hits.hit
    # Brute force interpolates linearly over a step, which is coarse where the surface is curved.
    assert np.linalg.norm(hits.points_mm - points, axis=1)[seen].max() < 0.02


@pytest.mark.parametrize("surface", quick(STEEP, every=2))
@pytest.mark.parametrize("slanting", [False, True], ids=["camera", "slanting"])
def test_hits_are_on_the_ray_and_on_the_surface(surface, slanting):
    origins, directions = _slanting(3000) if slanting else (ABOVE, _fan(3000))
    hits = surface.trace(origins, directions)
    points, hit = hits.points_mm, hits.hit
    off = np.linalg.norm(np.cross(points - origins, directions), axis=1)
    assert (off[hit] / np.linalg.norm(directions, axis=1)[hit]).max() < 1e-9
    z, zx, zy = surface.evaluate(points[hit, 0], points[hit, 1])
    assert np.abs(z - points[hit, 2]).max() < 1e-6 * (1 + np.hypot(zx, zy).max())
    slopes = -hits.normals[hit, :2] / hits.normals[hit, 2:]
    np.testing.assert_allclose(slopes, np.stack([zx, zy], axis=1), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(hits.normals[hit], axis=1), 1.0, rtol=1e-12)
    assert (np.broadcast_to(directions, points.shape)[hit] * hits.normals[hit]).sum(1).max() < 1e-6
    assert not hits.points_mm[~hit].any()
    assert not hits.normals[~hit].any()


@pytest.mark.parametrize("slope", [0.0, 0.3, 3.0])
def test_hits_on_a_plane_equal_the_closed_form(slope):
    plane, directions = Plane(60.0, 30.0, 0.0, slope), _fan(2000, reach=0.05)
    hits = plane.trace(ABOVE, directions)
    t = (600.0 - 30.0) / (1 + slope * directions[:, 1])
    points = ABOVE + t[:, None] * directions
    within = np.hypot(points[:, 0], points[:, 1]) <= 60
    np.testing.assert_array_equal(hits.hit, within)
    np.testing.assert_allclose(hits.points_mm[within], points[within], atol=1e-9)


def test_vertical_rays_hit_the_field_below_them():
    surface = Coin(60.0, relief_mm=5.0, seed=2)
    x, y = np.random.default_rng(0).uniform(-60, 60, (2, 5, 400))
    origins = np.stack([x, y, np.full_like(x, 500.0)], axis=-1)
    hits = surface.trace(origins, np.array([0.0, 0.0, -1.0]))
    assert hits.hit.shape == (5, 400)
    np.testing.assert_array_equal(hits.hit, surface.inside(x, y))
    z, zx, zy = surface.evaluate(x, y)
    np.testing.assert_allclose(hits.points_mm[..., 2], np.where(hits.hit, z, 0), atol=1e-9)
    normals = np.stack([-zx, -zy, np.ones_like(z)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    np.testing.assert_allclose(hits.normals[hits.hit], normals[hits.hit], atol=1e-9)


def test_hemisphere_is_visible_down_to_the_cone_of_tangents():
    radius, rays = 50.0, _fan(20_000, reach=0.1)
    hits = SphericalCap(radius, radius).trace(ABOVE, rays)
    sine = np.hypot(rays[:, 0], rays[:, 1]) / np.linalg.norm(rays, axis=1)
    np.testing.assert_array_equal(hits.hit, sine < radius / 600.0)
    np.testing.assert_allclose(np.linalg.norm(hits.points_mm[hits.hit], axis=1), radius, rtol=1e-12)
    np.testing.assert_allclose(hits.normals, hits.points_mm / radius, atol=1e-14)
    # The outermost rays are tangent to it at z = r^2 / d.
    lowest = hits.points_mm[hits.hit, 2].min()
    assert radius**2 / 600 <= lowest < radius**2 / 600 + 1.5


def test_a_high_step_hides_the_tread_behind_it():
    """Seen from the left at 45 degrees, a wall of 8 mm hides 8 mm of the tread behind it."""
    gauge = StepGauge(40.0, (8.0, 0.0), edge_mm=1e-4)
    x = np.linspace(-20.0, 20.0, 4001)
    origins = np.stack([x - 50.0, np.zeros_like(x), np.full_like(x, 50.0)], axis=1)
    hits = gauge.trace(origins, np.array([1.0, 0.0, -1.0]))
    assert hits.hit.all()
    on_top, below = hits.points_mm[:, 2] > 7.999, hits.points_mm[:, 2] < 0.001
    assert np.all(on_top | below)
    assert hits.points_mm[on_top, 0].max() == pytest.approx(0.0, abs=0.011)
    assert hits.points_mm[below, 0].min() == pytest.approx(8.0, abs=0.011)


def test_a_rising_step_shows_its_wall():
    gauge = StepGauge(40.0, (0.0, 8.0), edge_mm=1e-4)
    z = np.linspace(0.01, 7.99, 50)
    origins = np.stack([np.full_like(z, -100.0), np.zeros_like(z), z + 100.0], axis=1)
    hits = gauge.trace(origins, np.array([1.0, 0.0, -1.0]))
    np.testing.assert_allclose(hits.points_mm[:, 2], z, atol=1e-3)
    assert np.abs(hits.points_mm[:, 0]).max() < 1e-4
    assert hits.normals[:, 0].max() < -0.99


@pytest.mark.parametrize(
    ("origin", "direction"),
    [
        pytest.param((0, 0, 100), (0, 0, 1), id="away"),
        pytest.param((0, 0, 100), (1, 0, 0), id="level-above"),
        pytest.param((100, 0, 100), (0, 0, -1), id="next-to-it"),
        pytest.param((-100, 0, 1), (1, 0, 0), id="through-the-wall"),
        pytest.param((0, 0, -5), (0, 0, 1), id="from-below"),
        pytest.param((100, 0, 50), (1, 0, -1), id="outward"),
    ],
)
@pytest.mark.parametrize(
    "surface",
    [Plane(60.0, 2.0), StepGauge(60.0, (4.0, 2.0)), Ripples(64.0, 2.0), SphericalCap(60.0, 0.9)],
)
def test_misses(surface, origin, direction):
    hits = surface.trace(np.array([origin], float), np.array([direction], float))
    assert hits.hit.tolist() == [False]


@pytest.mark.parametrize(
    ("origin", "direction"),
    [
        pytest.param((100, 0, 30), (1, 0, 0), id="level"),
        pytest.param((0, 80, 20), (0, 1, 0.01), id="level the other way"),
        pytest.param((90, 0, 60), (1, 0, 0.3), id="upward"),
    ],
)
@pytest.mark.parametrize("height", [50.0, 40.0], ids=["half sphere", "cap"])
def test_a_dome_behind_the_origin_of_a_ray_is_not_hit(origin, direction, height):
    """In the opposite direction, the ray hits: the line crosses the dome above the board."""
    cap = SphericalCap(50.0, height)
    origin, direction = np.array([origin], float), np.array([direction], float)
    assert cap.trace(origin, -direction).hit.tolist() == [True]
    hits = cap.trace(origin, direction)
    assert hits.hit.tolist() == [False]
    assert not hits.points_mm.any()


def test_horizontal_ray_hits_the_side_of_a_dome():
    cap = SphericalCap(50.0, 50.0)
    hits = cap.trace(np.array([-100.0, 0.0, 30.0]), np.array([2.0, 0.0, 0.0]))
    np.testing.assert_allclose(hits.points_mm, [-40.0, 0.0, 30.0], atol=1e-9)


def test_march_and_newton_agree():
    """With wider bounds than necessary, rays are marched instead of solved by Newton's method."""
    coin, rays = Coin(60.0, seed=4), _fan(2000)
    origins = np.tile(ABOVE, (len(rays), 1))
    t, zx, zy = meet_field(coin.evaluate, 60.0, coin.bounds, origins, rays)
    wide = FieldBounds(coin.bounds.bottom_mm - 1, coin.bounds.top_mm + 1, 40.0)
    again = meet_field(coin.evaluate, 60.0, wide, origins, rays)
    both = np.isfinite(t) & np.isfinite(again[0])
    assert both.sum() > 500
    np.testing.assert_allclose(again[0][both], t[both], atol=1e-9)
    np.testing.assert_allclose(again[1][both], zx[both], atol=1e-8)
    np.testing.assert_allclose(again[2][both], zy[both], atol=1e-8)


def test_field_without_bounds_is_refused():
    bounds = FieldBounds(0.0, 1.0, math.inf)
    with pytest.raises(DataError, match="without finite bounds"):
        meet_field(Plane(9.0).evaluate, 9.0, bounds, ABOVE[None], -ABOVE[None])


def test_shadow_grid_contains_the_heights():
    coin = Coin(40.0, seed=3)
    grid = coin.shadow_caster(0.5)
    rows, columns = grid.heights_mm.shape
    x = grid.origin_xy_mm[0] + 0.5 * np.arange(columns)
    y = grid.origin_xy_mm[1] + 0.5 * np.arange(rows)
    assert (x[0], y[0]) == (-41.0, -41.0)
    assert (x[-1], y[-1]) == (41.0, 41.0)
    x, y = np.meshgrid(x, y)
    expected = np.where(coin.inside(x, y), coin.evaluate(x, y)[0], 0.0)
    np.testing.assert_allclose(grid.heights_mm, expected, atol=1e-6)
    assert grid.heights_mm.dtype == np.float32
    assert not np.concatenate([grid.heights_mm[[0, -1]].ravel(), grid.heights_mm[:, 0]]).any()


@pytest.mark.parametrize(
    ("step", "message"),
    [(0.0, "is 0.0 mm"), (math.nan, "is nan mm"), (-1.0, "-1"), (1e-4, "larger step")],
)
def test_an_invalid_shadow_step_is_reported_in_one_line(step, message):
    with pytest.raises(DataError, match=message) as caught:
        Plane(60.0).shadow_caster(step)
    assert "\n" not in str(caught.value)
