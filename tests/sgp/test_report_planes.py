"""Planes of a report: encoded and decoded, quantised no worse than stated."""

import base64
import re
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from acquisition import angle_deg
from sgp.report import Plane, vectors_plane
from sgp.report.html import Html, joined, script_json, tag, text
from sgp.report.lights import bar_chart
from sgp.report.page import colour_maps
from sgp.report.planes import VECTOR_STEPS, colour_plane, scalar_plane
from sgp.report.scripts import LinkError, linked


def samples_of(plane: Plane) -> np.ndarray:
    """Decode a plane pixel by pixel, as the page does."""
    rows, columns, channels = plane.samples.shape
    bits = 8 * plane.samples.itemsize
    data = np.frombuffer(zlib.decompress(base64.b64decode(plane.encoded)), np.uint8)
    parts = data.reshape(channels, bits // 8, rows, columns).astype(int)
    folded = parts[:, 0] + (256 * parts[:, 1] if bits == 16 else 0)
    found = np.zeros((rows + 1, columns + 1, channels), int)
    for channel, row, column in np.ndindex(channels, rows, columns):
        up, left = found[row, column + 1, channel], found[row + 1, column, channel]
        predicted = sorted((left, up, left + up - found[row, column, channel]))[1]
        value = folded[channel, row, column]
        difference = value // 2 if value % 2 == 0 else -(value + 1) // 2
        found[row + 1, column + 1, channel] = (predicted + difference) % (1 << bits)
    return found[1:, 1:]


def vectors_of(samples: np.ndarray) -> np.ndarray:
    """Return the unit vectors of samples of a plane; 0 without a value."""
    e = (samples.astype(float) - 1) * (2 / VECTOR_STEPS) - 1
    z = 1 - np.abs(e).sum(axis=2)
    folded = (1 - np.abs(e[..., ::-1])) * np.where(e < 0, -1, 1)
    v = np.dstack([np.where(z[..., None] < 0, folded, e), z])
    v /= np.linalg.norm(v, axis=2, keepdims=True)
    return np.where(samples[..., :1] == 0, 0, v)


@settings(max_examples=40)
@given(
    st.sampled_from([np.uint8, np.uint16]).flatmap(
        lambda dtype: arrays(dtype, array_shapes(min_dims=3, max_dims=3, max_side=6))
    )
)
def test_a_decoded_plane_has_the_samples_that_were_encoded(samples):
    np.testing.assert_array_equal(samples_of(Plane("any", "scalar", samples)), samples)


@settings(max_examples=60)
@given(arrays(np.float32, (3, 4, 3), elements=st.floats(-1, 1, width=32)))
def test_directions_keep_their_angle(vectors):
    length = np.linalg.norm(vectors, axis=2, keepdims=True)
    vectors = np.where(length > 0.1, vectors / np.maximum(length, 0.1), 0).astype(np.float32)
    plane = vectors_plane("normals", vectors, "")
    known = vectors.any(axis=2)
    np.testing.assert_array_equal(plane.samples[..., 0] > 0, known)
    found = vectors_of(plane.samples)
    assert np.all(angle_deg(found[known], vectors[known]) < 0.06)


def test_the_direction_to_the_camera_is_exact():
    up = np.zeros((1, 2, 3), np.float32)
    up[0, 0, 2] = 1
    found = vectors_of(vectors_plane("normals", up, "").samples)
    np.testing.assert_array_equal(found, up)


@pytest.mark.parametrize("bits", [8, 16])
def test_numbers_are_right_to_half_a_step(bits):
    values = np.random.default_rng(3).normal(5, 2, (20, 30)).astype(np.float32)
    values[3:6, 2:9] = np.nan
    plane = scalar_plane("height", values, "Height", "mm", "height", bits=bits)
    found = plane.low + plane.step * (plane.samples[..., 0].astype(float) - 1)
    known = np.isfinite(values)
    np.testing.assert_array_equal(plane.samples[..., 0] > 0, known)
    assert np.abs(found - values)[known].max() <= 0.5001 * plane.step
    assert plane.step == pytest.approx(np.ptp(values[known]) / ((1 << bits) - 2))


def test_maps_without_range_or_value_are_planes():
    same = scalar_plane("height", np.full((2, 3), 7, np.float32), "", "mm", "height")
    assert same.low + same.step * (int(same.samples[0, 0, 0]) - 1) == 7
    empty = scalar_plane("height", np.full((2, 3), np.nan, np.float32), "", "mm", "height")
    assert not empty.samples.any()
    assert colour_plane("albedo", np.zeros((2, 3), np.uint8), "").samples.shape == (2, 3, 1)


def test_texts_are_escaped_once_and_markup_is_not():
    hostile = "</script><b onload='x'>\"&\u202e\x00"
    escaped = "&lt;/script&gt;&lt;b onload=&#x27;x&#x27;&gt;&quot;&amp;\\u202e\\x00"
    assert text(hostile) == escaped
    assert tag("p", hostile, title=hostile) == f'<p title="{escaped}">{escaped}</p>'
    assert joined(tag("b", "x"), "<", [Html("<br>"), ">"]) == "<b>x</b>&lt;<br>&gt;"
    assert tag("img", alt="", src=None) == "<img alt>"
    assert "<" not in script_json({hostile: hostile})


@pytest.mark.parametrize("rows", [3, 200, 777])
def test_the_size_of_a_plane_is_estimated_from_a_part_of_it(rows):
    random = np.random.default_rng(8)
    noise = random.normal(size=(rows, 400)) + np.linspace(0, 40, rows)[:, None]
    plane = scalar_plane("any", noise.astype(np.float32), "", "", "plain", bits=16)
    assert plane.estimated == pytest.approx(len(plane.encoded), rel=0.05)


def test_modules_are_linked_after_those_that_they_import(monkeypatch):
    sources = {
        "views/one.js": 'import { a } from "../js/a.js";\nexport const label = a;\n',
        "js/a.js": "export const a = 1;\nexport function unused() {}\n",
        "js/main.js": 'import { a } from "./a.js";\nexport function start(views) {}\n',
        "views/wrong.js": 'import { missing } from "../js/a.js";\n',
        "views/round.js": 'import { b } from "./round.js";\n',
        "views/other.js": "export default 3;\n",
    }
    monkeypatch.setattr("sgp.report.scripts.asset", sources.__getitem__)
    link = linked.__wrapped__
    script = link(("one",))
    places = [script.index(f"const {name} =") for name in ("$js_a", "$views_one", "$js_main")]
    assert places == sorted(places)
    assert script.endswith("$js_main.start([{id: 'one', ...$views_one}]);\n")
    for view, problem in (
        ("wrong", "does not export missing"),
        ("round", "import each other"),
        ("other", "has a form that is not linked"),
    ):
        with pytest.raises(LinkError, match=problem):
            link((view,))


@pytest.mark.parametrize(
    ("values", "ticks"),
    [
        ([0.2, 0.9, float("nan")], ["0", "0.25", "0.5", "0.75", "1"]),
        ([30.0, 12.0, 3.0], ["0", "10", "20", "30"]),
        ([0.0, 0.0, 0.0], ["0", "0.25", "0.5", "0.75", "1"]),
        ([float("nan")] * 3, ["0", "0.25", "0.5", "0.75", "1"]),
    ],
)
def test_charts_have_a_bar_for_each_known_value_and_round_ticks(values, ticks):
    chart = bar_chart("Angle, deg", ["<a>", "b", "c"], values)
    assert chart.count("<rect") == int(np.isfinite(values).sum())
    assert re.findall(r'text-anchor="end">([^<]*)<', chart) == ticks
    assert "<a>" not in chart
    assert "&lt;a&gt;" in chart


def test_colour_maps_are_read_by_their_lightness():
    for name, encoded in colour_maps().items():
        samples = np.frombuffer(base64.b64decode(encoded), np.uint8).reshape(1, 256, 3)
        lab = cv2.cvtColor((samples / 255).astype(np.float32), cv2.COLOR_RGB2LAB)[0, ::-5][::-1]
        steps = np.diff(lab[:, 0])
        if name == "signed":  # lightest at 0, and equally dark at both ends
            assert (steps[:25] > 0).all()
            assert (steps[26:] < 0).all()
            assert abs(lab[0, 0] - lab[-1, 0]) < 3
        else:
            assert (steps > 0).all()
            assert lab[-1, 0] - lab[0, 0] > 70
