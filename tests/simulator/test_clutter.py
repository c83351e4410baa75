"""Clutter and relief: hits, normals, shadows and highlights at their known positions."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import Lights
from simulator import ChromeSphere, Lens, Scene, bench_camera, bench_sensor, render
from simulator.rendering import find_mirrored_lights
from simulator.rendering.trace import see
from simulator.scene import Ball, Box
from simulator.shapes import BandNoise, Even

FROM_LEFT = Lights(directions=np.array([[-1.0, 0.0, 1.0]]) / np.sqrt(2))
FLAT = Lens.orthographic(120, 100, 1.0, 200.0)


def scene(*clutter, **more):
    arguments = {"board": Even(0.4), "ambient": 0.0, "surroundings": 0.0} | more
    return Scene(
        arguments.pop("body", None),
        arguments.pop("lights", FROM_LEFT),
        arguments.pop("lens", FLAT),
        bench_sensor(),
        1.0,
        clutter=clutter,
        **arguments,
    )


def looking_down(scene, x, y):
    origins = np.column_stack([x, y, np.full(len(x), 200.0)]).astype(float)
    return see(scene, origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape).copy())


def test_rays_end_on_a_ball_and_on_a_turned_box():
    both = scene(Ball((-20, 0, 10), 10), Box((20, 0), (20, 8, 5), turn_deg=90))
    seen = looking_down(both, [-20, -14, 20, 20, 27, 50], [0, 8, 0, 9, 0, 0])
    np.testing.assert_array_equal(seen.item, [0, -1, 1, 1, -1, -1])
    np.testing.assert_allclose(seen.points_mm[:, 2], [20, 0, 5, 5, 0, 0], atol=1e-9)
    np.testing.assert_allclose(seen.normals[:, 2], 1.0)
    seen = looking_down(both, [-14], [0])
    np.testing.assert_allclose(seen.normals[0], [0.6, 0, 0.8], atol=1e-9)


def test_a_camera_sees_the_side_of_a_box():
    lens = Lens(bench_camera(64, 50))
    one = scene(Box((100, 0), (20, 30, 40), turn_deg=30.0), lens=lens)
    at = np.array([100 - 10 * np.cos(np.pi / 6), -5.0, 20.0])
    origin = np.array([[0.0, 0.0, 600.0]])
    seen = see(one, origin, (at - origin) / (600.0 - at[2]))
    np.testing.assert_allclose(seen.points_mm[0], at, atol=1e-9)
    np.testing.assert_allclose(seen.normals[0], [-np.cos(np.pi / 6), -0.5, 0.0], atol=1e-9)


def test_shadows_have_the_length_of_the_height():
    """Under a light at 45 degrees from the left, the shadow of a box is as long as it is high."""
    plane = render(scene(Box((0, 0), (20, 30, 16)))).planes[0, 50]
    x = np.arange(120) - 59.5
    board = 0.4 / np.sqrt(2)
    np.testing.assert_allclose(plane[(x < -11) | (x > 27)], board, rtol=1e-5)
    np.testing.assert_allclose(plane[(x > 11) & (x < 25)], 0.0)
    np.testing.assert_allclose(plane[np.abs(x) < 9], board, rtol=1e-5)


def test_a_ball_is_shaded_and_casts_a_shadow():
    plane = render(scene(Ball((0, 0, 12), 12, 0.7))).planes[0]
    side = np.sqrt(12**2 - 0.5**2 - 6.5**2)
    expected = 0.7 * (6.5 / 12 + side / 12) / np.sqrt(2)
    assert plane[50, 53] == pytest.approx(expected, rel=2e-3)
    assert plane[50, 74] == 0.0
    assert plane[50, 40] == pytest.approx(0.4 / np.sqrt(2), rel=1e-5)


def test_gloss_adds_a_highlight():
    matte, glossy = (
        render(scene(Ball((0, 0, 12), 12, 0.5, roughness))).planes[0] for roughness in (None, 0.1)
    )
    assert glossy.max() > 2 * matte.max()
    # It mirrors the light at 45 degrees where the normal leans by half of that.
    _, x = np.unravel_index(glossy.argmax(), glossy.shape)
    assert x == pytest.approx(59.5 - 12 * np.sin(np.pi / 8), abs=1)


def test_clutter_hides_highlights_from_lights_and_camera():
    lens = Lens(bench_camera(64, 50))
    lights = Lights(positions_mm=np.array([[-300.0, 0, 300]]))
    ball = ChromeSphere((60, 0, 10), 10)
    open_ = scene(spheres=(ball,), lights=lights, lens=lens, board=Even(0.0))
    assert render(open_).planes[0].max() > 0.1
    shading, hiding = (Box((40, 0), (4, 60, high), albedo=0.0) for high in (60, 190))
    assert np.isfinite(find_mirrored_lights(replace(open_, clutter=(shading,))).pixels).all()
    assert np.isnan(find_mirrored_lights(replace(open_, clutter=(hiding,))).pixels).all()
    for box in (shading, hiding):
        assert render(replace(open_, clutter=(box,))).planes[0].max() == 0


def test_spheres_mirror_clutter():
    lens = Lens(bench_camera(200, 160))
    ball, beside = ChromeSphere((0, 0, 20), 20), Ball((45, 0, 20), 20, 0.9)
    lights = Lights(positions_mm=np.array([[-100.0, 200, 300]]))
    alone = scene(spheres=(ball,), lights=lights, lens=lens)
    one, two = (render(s).planes[0] for s in (alone, replace(alone, clutter=(beside,))))
    inside = render(alone).truth.sphere_masks[0]
    assert np.abs(two - one)[inside].max() > 0.1


def test_a_relief_is_met_where_it_is():
    relief = BandNoise(260.0, 0.4, 12.0, 1.0, 3)
    uneven = scene(relief=relief)
    rng = np.random.default_rng(1)
    target = rng.uniform(-80, 80, (50, 2))
    z = relief.evaluate(*target.T)[0] - relief.top_mm
    points = np.column_stack([target, z])
    assert -4 < z.min() < z.max() <= 0
    origin = np.tile([0.0, 0.0, 600.0], (50, 1))
    seen = see(uneven, origin, (points - origin) / (600.0 - z)[:, None])
    np.testing.assert_allclose(seen.points_mm, points, atol=1e-7)
    _, zx, zy = relief.evaluate(*target.T)
    np.testing.assert_allclose(seen.normals[:, 0] / seen.normals[:, 2], -zx, atol=1e-7)
    np.testing.assert_allclose(seen.normals[:, 1] / seen.normals[:, 2], -zy, atol=1e-7)
