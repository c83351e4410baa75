"""Lights: refusals, the near-light model against its closed form, matching to frames."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import DataError, LightErrors, Lights
from acquisition.values import led_id, light_id
from tests.cases import cases

UP = [[0.0, 0.0, 1.0]]


@cases(
    ("fields", "message"),
    {
        "nothing": ({}, "either directions or positions"),
        "both": ({"directions": UP, "positions_mm": UP}, "not both"),
        "zero": ({"directions": [[0, 0, 1], [0, 0, 0]]}, "L01 is a zero vector"),
        "nan": ({"directions": [[0, np.nan, 1]]}, "light 0 is not finite"),
        "two columns": ({"directions": [[0, 1]]}, "N x 3"),
        "dark": ({"directions": UP, "intensities": [0.0]}, "L00 has an intensity"),
        "count": ({"directions": UP, "intensities": [1.0, 1.0]}, "intensities"),
        "mu": ({"directions": UP, "mu": [-1.0]}, "mu"),
        "ids": ({"directions": UP, "ids": ("a", "b")}, "2 ids"),
        "axis": ({"directions": UP, "axes": [[0, 0, 0]]}, "axes"),
    },
)
def test_lights_refuse(fields, message):
    with pytest.raises(DataError, match=message):
        Lights(**fields)


def test_directions_are_stored_as_unit_vectors():
    lights = Lights(directions=[[0, 0, 5], [3, 0, 4]])
    np.testing.assert_allclose(lights.directions, [[0, 0, 1], [0.6, 0, 0.8]])
    assert lights.ids == ("L00", "L01")
    assert not lights.near


def test_near_light_follows_the_inverse_square_and_cosine_laws():
    """A light 400 mm above, facing down: E(x) = (h / r)^2 (h / r)^mu with r^2 = h^2 + x^2."""
    height, x, mu = 400.0, 300.0, 1.5
    lights = Lights(positions_mm=[[0, 0, height]], mu=[mu])
    r = np.hypot(height, x)
    (vector,) = lights.vectors_at([x, 0.0, 0.0])
    np.testing.assert_allclose(np.linalg.norm(vector), (height / r) ** (2 + mu), rtol=1e-12)
    np.testing.assert_allclose(vector / np.linalg.norm(vector), [-x / r, 0, height / r])


def test_a_point_behind_the_led_gets_no_light():
    lights = Lights(positions_mm=[[0, 0, 100.0]], mu=[0.0])
    np.testing.assert_array_equal(lights.vectors_at([0.0, 0.0, 150.0]), [[0, 0, 0]])


@pytest.mark.parametrize("mu", [0.0, 1.5])
def test_a_point_on_the_led_gets_no_light_and_no_warning(mu):
    lights = Lights(positions_mm=[[30.0, 0, 100.0], [0, 0, 400.0]], mu=[mu, mu])
    on, away = lights.vectors_at([[30.0, 0.0, 100.0], [0.0, 0.0, 0.0]])[0]
    np.testing.assert_array_equal(on, 0)
    np.testing.assert_allclose(np.linalg.norm(away), 1)


def test_a_light_that_points_away_is_refused():
    lights = Lights(positions_mm=[[0, 0, 100.0]], axes=UP)
    with pytest.raises(DataError, match="points away"):
        lights.vectors_at([0.0, 0.0, 0.0])


@given(
    st.tuples(st.floats(-500, 500), st.floats(-500, 500), st.floats(50, 900)),
    st.floats(0, 4),
)
def test_at_the_origin_near_and_distant_agree(position, mu):
    near = Lights(positions_mm=[position], mu=[mu])
    origin = np.zeros((2, 2, 3))
    np.testing.assert_allclose(
        near.vectors_at(origin), near.distant().vectors_at(origin), atol=1e-12
    )


def test_lights_at_a_distance_are_as_bright_at_the_point_they_refer_to():
    errors = LightErrors(
        covariances=np.tile(np.diag([1e-4, 4e-4]), (2, 1, 1)), intensity_std=np.array([0.1, 0.2])
    )
    distant = Lights(directions=[[0, 0, 1], [3, 0, 4]], intensities=[2, 5], errors=errors)
    point = np.array([40.0, -20.0, 5.0])
    near = distant.at_distance(500, point)
    np.testing.assert_allclose(near.positions_mm, np.add(point, [[0, 0, 500], [300, 0, 400]]))
    seen = near.vectors_at(point) * near.intensities[:, :1]
    np.testing.assert_allclose(seen, distant.unit_directions * [[2], [5]])
    # 0.01 and 0.02 radians are 5 and 10 mm across the direction.
    for covariance, direction in zip(near.errors.covariances, distant.unit_directions, strict=True):
        np.testing.assert_allclose(np.linalg.eigvalsh(covariance), [0, 25, 100], atol=1e-9)
        np.testing.assert_allclose(covariance @ direction, 0, atol=1e-9)
    relative = near.errors.intensity_std / near.intensities
    np.testing.assert_allclose(relative[:, 0], [0.05, 0.04])


@cases(
    ("lights", "distance"),
    {
        "no distance": (Lights(directions=[[0, 0, 1]]), 0.0),
        "not a number": (Lights(directions=[[0, 0, 1]]), float("nan")),
        "positions": (Lights(positions_mm=[[0, 0, 100]]), 400.0),
    },
)
def test_a_distance_that_is_no_use_is_refused(lights, distance):
    with pytest.raises(DataError, match="distance"):
        lights.at_distance(distance)


def test_take_keeps_every_field_in_order():
    lights = Lights(positions_mm=np.eye(3) * 10, intensities=[1, 2, 3], mu=[0, 1, 2])
    two = lights.take([2, 0])
    assert two.ids == ("L02", "L00")
    np.testing.assert_array_equal(two.positions_mm, [[0, 0, 10], [10, 0, 0]])
    np.testing.assert_array_equal(two.intensities[:, 0], [3, 1])
    np.testing.assert_array_equal(two.mu, [2, 0])


@cases(
    ("ids", "names", "expected", "by_name"),
    {
        "by name": (("a", "b"), ("b.png", "a.png"), [1, 0], True),
        "paths and case": (("x/A.TIF", "b"), (r"C:\d\a.png", "B"), [0, 1], True),
        "by order": (("a", "b"), ("p", "q"), [0, 1], False),
        "fewer frames than lights": (("a", "b", "c"), ("c",), [2], True),
        "lights named like images of LEDs": (
            ("L05_E0.png", "L03_E0.png", "L12_E0.png"),
            ("L03", "L12", "L05"),
            [1, 2, 0],
            True,
        ),
        "images of LEDs": (("L05", "L03"), ("L3_E1_R2.tif", "L05_E0.z.tif"), [1, 0], True),
        "fewer LEDs than lights": (("L01_E0", "L00_E0", "L07_E0"), ("L00",), [1], True),
        "whole names first": (("L05_E1", "L05_E0"), ("L05_E0", "L05_E1"), [1, 0], True),
        "lights not named": (("L00", "L01"), ("L04_E0", "L00_E0"), [0, 1], False),
        "images not named": (("L03", "L05"), ("IMG_1", "IMG_2"), [0, 1], False),
    },
)
def test_match(ids, names, expected, by_name):
    lights = Lights(directions=np.eye(3)[: len(ids)], ids=ids)
    assert lights.match(names) == (expected, by_name)


@cases(
    ("names", "message"),
    {
        "counts differ": (("p",), "1 image for 2 lights"),
        "only some match": (("a", "q"), "q does not"),
        "two frames of one light": (("a", "a"), "share a name"),
    },
)
def test_match_refuses(names, message):
    lights = Lights(directions=np.eye(3)[:2], ids=("a", "b"))
    with pytest.raises(DataError, match=message):
        lights.match(names)


@cases(
    ("ids", "names", "message"),
    {
        "no LED matches": (("L10", "L11"), ("L20", "L21"), "0 of 2 .* L20 does not"),
        "one LED does not": (("L05_E0", "L06_E0"), ("L05", "L07"), "1 of 2 .* L07 does not"),
        "two lights of an LED": (("L05_E0", "L05_E1"), ("L05", "L06"), "0 of 2 .* L05 does not"),
        "two images of an LED": (("L05", "L06"), ("L05_E0", "L05_E1"), "share a name"),
    },
)
def test_lights_of_leds_are_never_matched_by_order(ids, names, message):
    lights = Lights(directions=np.eye(3)[: len(ids)], ids=ids)
    with pytest.raises(DataError, match=message):
        lights.match(names)


@cases(
    ("name", "expected"),
    {
        "Windows path": (r"D:\dome\IMG 007.Tif", "img 007"),
        "number before the type": ("a/b/chrome.0.tga", "chrome.0"),
        "a number is no file type": ("chrome.0", "chrome.0"),
        "LED": ("L07", "l07"),
        "a word after a dot is no file type": ("scan.left.PNG", "scan.left"),
        "a version is no file type": ("IMG_0.v1", "img_0.v1"),
        "camera RAW": ("IMG_0.CR2", "img_0"),
        "two file types": ("a.tif.png", "a"),
        "nothing but a file type": (".png", ".png"),
        "a drive": ("C:/", "c:"),
    },
)
def test_light_id_is_the_stem(name, expected):
    assert light_id(name) == expected
    assert light_id(expected) == expected


@given(st.text() | st.text(alphabet="a.:/\\ tifpngTIFPNG", max_size=20))
def test_light_id_is_idempotent(name):
    assert light_id(light_id(name)) == light_id(name)


def test_led_id_has_two_digits_or_more():
    assert [led_id(led) for led in (7, 35, 100)] == ["L07", "L35", "L100"]
