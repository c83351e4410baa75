"""Light of single points: lamps, their discs, irradiance, and radiance toward the camera."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import Lights
from simulator import Lens, Scene, bench_sensor
from simulator.rendering.shade import Shader, irradiance, lamp_parts, lamp_table
from simulator.rendering.trace import Seen
from simulator.scene import Ggx, Lambert
from simulator.shapes import Plane

AXES = np.array(
    [
        (0, 0, -1),
        (-1, 0, 0),
        (1, 0, 0),
        (0, -1, 0),
        (-1, -1, 0),
        (-1, 0, -1),
        (0.3, -0.5, -0.7),
    ],
    float,
)
AXES /= np.linalg.norm(AXES, axis=1, keepdims=True)
PLACES = -300.0 * AXES + [10.0, 20.0, 30.0]
MU = np.array([0.0, 1.0, 2.5, 1.0, 0.5, 3.0, 1.3])
NEAR = Lights(positions_mm=PLACES, axes=AXES, mu=MU)
DISTANT = Lights(directions=np.array([[0.6, 0, 0.8], [0, -0.28, 0.96]]))
LENS = Lens.orthographic(6, 4, 1.0, 500.0)


def test_a_near_lamp_has_irradiance_1_at_the_origin_on_a_surface_that_faces_it():
    toward = PLACES / np.linalg.norm(PLACES, axis=1, keepdims=True)
    own = irradiance(lamp_table(NEAR), np.zeros((7, 3)), toward, near=True)
    np.testing.assert_allclose(np.diag(own), 1.0, rtol=1e-6)


def test_the_table_of_distant_lamps():
    table = lamp_table(DISTANT)
    np.testing.assert_array_equal(table[:, :3], DISTANT.directions)
    np.testing.assert_array_equal(table[:, 7], 1.0)


def test_irradiance_from_near_lamps():
    """One point more than two blocks, some of them behind a lamp or facing away from it."""
    dice = np.random.default_rng(1)
    points = dice.uniform(-400, 400, (2049, 3))
    normals = dice.normal(size=(2049, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    way = PLACES[:, None] - points
    r = np.linalg.norm(way, axis=-1)
    cosine = np.clip(-(way * AXES[:, None]).sum(-1) / r, 0, None)
    facing = np.clip((way * normals).sum(-1) / r, 0, None)
    at_origin = np.linalg.norm(PLACES, axis=1)
    scale = at_origin**2 / (-(PLACES * AXES).sum(-1) / at_origin) ** MU
    # Behind itself a lamp gives no light, even if its light does not depend on the angle.
    expected = (cosine > 0) * cosine ** MU[:, None] * facing / r**2 * scale[:, None]
    assert 0.1 < (expected == 0).mean() < 0.9
    found = irradiance(lamp_table(NEAR), points, normals, near=True)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-9)
    # Nor in its own plane.
    table = lamp_table(
        Lights(positions_mm=np.array([[100.0, 0, 100]]), axes=np.array([[-1.0, 0, 0]]), mu=[0.0])
    )
    up = np.array([[0.0, 0, 1]])
    assert irradiance(table, np.array([[100.0, 0, 0]]), up, near=True)[0, 0] == 0
    assert irradiance(table, np.array([[99.0, 0, 0]]), up, near=True)[0, 0] > 0


def test_irradiance_from_distant_lamps():
    normals = np.array([[0, 0, 1.0], [0.6, 0, -0.8], [0, 1, 0], [0, -1, 0]])
    found = irradiance(lamp_table(DISTANT), np.ones((4, 3)), normals, near=False)
    np.testing.assert_allclose(found, [[0.8, 0, 0, 0], [0.96, 0, 0, 0.28]], atol=1e-7)


def test_the_disc_of_a_lamp_is_covered_uniformly():
    """Points of Vogel's spiral: square roots as radii, and the golden angle from point to point."""
    count, radius = 200, 7.0
    offsets = lamp_parts(NEAR, radius, count) - PLACES[:, None]
    np.testing.assert_allclose(offsets @ AXES[:, :, None], 0, atol=1e-9)
    reach = np.linalg.norm(offsets, axis=-1)
    expected = radius * np.sqrt((np.arange(count) + 0.5) / count)
    np.testing.assert_allclose(reach, np.broadcast_to(expected, reach.shape), rtol=1e-9)
    along = offsets / reach[..., None]
    cosine = (along[:, 1:] * along[:, :-1]).sum(-1)
    np.testing.assert_allclose(cosine, np.cos(np.radians(137.50776405)), atol=1e-9)


@pytest.mark.parametrize("lights", [NEAR, DISTANT], ids=["near", "distant"])
def test_a_lamp_of_one_part_is_its_centre_or_direction(lights):
    places = lights.positions_mm if lights.near else lights.directions
    np.testing.assert_array_equal(lamp_parts(lights, 7.0, 1), np.asarray(places)[:, None])


@pytest.mark.parametrize(("lights", "parts"), [(NEAR, 2), (DISTANT, 1)], ids=["near", "distant"])
def test_only_near_lamps_have_parts(lights, parts):
    scene = Scene(None, lights, LENS, bench_sensor(), 1.0, soft_shadow_samples=2)
    assert Shader(scene, 1.0)._parts.shape == (len(lights), parts, 3)


@pytest.mark.parametrize("shadows", [True, False])
@pytest.mark.parametrize("body", [Plane(2.0), None])
def test_only_an_object_casts_shadows_if_they_are_on(body, shadows):
    scene = Scene(body, DISTANT, LENS, bench_sensor(), 1.0, shadows=shadows)
    assert (Shader(scene, 1.0).occluders.body is not None) == (body is not None and shadows)


WEIGHT = np.array([1.0, 0.6, 1.0, 0.5, 0.5, 0.25])
SEEN = Seen(
    points_mm=np.arange(18.0).reshape(6, 3) * [1, 1, 0],
    normals=np.tile([0.0, 0, 1], (6, 1)),
    on_object=np.array([True, True, False, True, True, False]),
    sphere=np.array([-1, 0, -1, 0, 0, 0]),
    lost=np.array([False, False, False, True, True, False]),
    weight=WEIGHT,
    item=np.full(6, -1),
    depth_mm=np.zeros(6),
)
COLOURS = np.array([[1.2, 0.9, 0.6], [0.8, 1.0, 1.1]])


@pytest.mark.parametrize("channel", [(0, 2, -1, 1, -1, 0), (-1, -1, 0, -1, 0, 2)])
def test_radiance_toward_the_camera(channel):
    """Mirrors dim what they show, and where they show nothing, they show the surroundings."""
    lights = Lights(DISTANT.directions, intensities=COLOURS)
    scene = Scene(None, lights, LENS, bench_sensor(), 1.0, ambient=0.1, surroundings=0.3)
    albedo = np.random.default_rng(1).uniform(0.1, 0.9, (6, 3)).astype(np.float32)
    shade = Shader(scene, 1.0).shade(SEEN, albedo, np.array(channel, np.int8))
    lit, ambient, dark = shade
    for k, one in enumerate(channel):
        own = slice(None) if one < 0 else slice(one, one + 1)
        paint = albedo[k, own] * (0 if SEEN.lost[k] else WEIGHT[k])
        dim = 0.3 * WEIGHT[k] if SEEN.lost[k] else 0.0
        assert ambient[k] == pytest.approx(0.1 * (paint.mean() + dim), rel=1e-5)
        for light in range(2):
            facing = DISTANT.directions[light, 2]
            expected = (paint * COLOURS[light, own]).mean() * facing
            expected += dim * COLOURS[light, own].mean()
            assert lit[light, k] == pytest.approx(expected, rel=1e-5)
    assert (lit.dtype, ambient.dtype) == (np.float32, np.float32)
    assert not dark.any()
    # The material is that of the object where it is seen directly.
    glossy = replace(scene, material=Ggx())
    other, _, _ = Shader(glossy, 1.0).shade(SEEN, albedo, np.array(channel, np.int8))
    assert scene.material == Lambert()
    np.testing.assert_array_equal((other != lit).any(axis=0), [True, *[False] * 5])
