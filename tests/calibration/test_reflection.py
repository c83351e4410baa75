import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.spheres import Ellipse, orthographic_directions
from calibration.spheres.geometry.reflection import mirror_points, reflected_rays

unit = st.floats(-0.6, 0.6)


@settings(max_examples=40)
@given(unit, unit, st.floats(0.7, 1.4), st.floats(20, 300))
def test_orthographic_mirror_law_on_square_and_oblong_pixels(x, y, ratio, radius):
    """The normal bisects the angle between the viewing direction and the light."""
    normal = np.array([x, y, np.sqrt(1 - x * x - y * y)])
    outline = Ellipse((50.0, 60.0), (radius, radius * ratio))
    pixel = np.array([50 + radius * x, 60 - radius * ratio * y])
    light = orthographic_directions(outline, pixel)
    assert np.linalg.norm(light) == pytest.approx(1, abs=1e-9)
    assert light @ normal == pytest.approx(normal[2], abs=1e-9)
    assert light + np.array([0, 0, 1]) == pytest.approx(2 * normal[2] * normal, abs=1e-9)


def test_a_highlight_gives_the_light_direction_and_not_the_normal():
    outline = Ellipse.circle(10.0, 10.0, 8.0)
    assert orthographic_directions(outline, (10.0, 10.0)) == pytest.approx([0, 0, 1])
    # If the normal is at 45 degrees, the light is at 90 degrees.
    edge = 10 + 8 * np.sqrt(0.5)
    assert orthographic_directions(outline, (edge, 10.0)) == pytest.approx([1, 0, 0], abs=1e-9)


def test_highlight_outside_is_nan():
    assert np.isnan(orthographic_directions(Ellipse.circle(0.0, 0.0, 5.0), (6.0, 0.0))).all()


@settings(max_examples=40)
@given(st.floats(-150, 150), st.floats(-150, 150), st.floats(5, 40), st.integers(0, 35))
def test_mirror_point_equals_an_independent_root(bench, dome_mm, x, y, radius, index):
    centre, light = np.array([x, y, radius]), dome_mm[index]
    point = mirror_points(bench.eye, light, centre, np.array(radius))
    assert np.linalg.norm(point - centre) == pytest.approx(radius, abs=1e-9)
    assert bench.project(point) == pytest.approx(bench.highlight(centre, radius, light), abs=1e-6)


def test_reflected_ray_hits_the_light(bench, dome_mm):
    centre, radius = np.array([40.0, -30.0, 20.0]), 20.0
    pixels = np.array([bench.highlight(centre, radius, light) for light in dome_mm])
    points, directions = reflected_rays(bench.camera.rays(pixels), centre - bench.eye, radius)
    gap = np.cross(dome_mm - (points + bench.eye), directions)
    assert np.linalg.norm(gap, axis=1).max() < 1e-5


def test_ray_that_misses_is_nan(bench):
    points, directions = reflected_rays(
        bench.camera.rays([[0.0, 0.0]]), np.array([0.0, 0.0, -580.0]), 20.0
    )
    assert np.isnan(points).all()
    assert np.isnan(directions).all()
