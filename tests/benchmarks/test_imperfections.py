"""The benchmark of imperfect recordings: its changes, and what it counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from acquisition import SRGB, Lights
from benchmarks.imperfections import __main__ as command
from benchmarks.imperfections.cases import CASES, NONE
from benchmarks.imperfections.recordings import Recording
from benchmarks.imperfections.remedies import Remedy
from benchmarks.imperfections.table import Key, Row, Table
from benchmarks.imperfections.trials import Outcome
from processing.checks import Cause
from simulator import bench_camera, dome_lights
from tests.cases import cases

MIRROR, HALF_TURN, Y_SIGN = (-1, 1, 1), (-1, -1, 1), (1, -1, 1)


def shaded(normals, directions):
    return np.einsum("nk,hwk->nhw", directions, normals).clip(0).astype(np.float32)


def ball(*, near: bool = False, uniform: bool = False) -> Recording:
    """Return an uneven part of a ball under nine lights."""
    y, x = np.mgrid[0.5:-0.6:50j, -0.7:0.4:60j]
    normals = np.dstack([x, y, np.sqrt(1 - x**2 - y**2)]).astype(np.float32)
    lights = dome_lights(9) if near else Lights(directions=dome_lights(9).positions_mm)
    directions = np.asarray(lights.distant().unit_directions if near else lights.unit_directions)
    mask = np.ones(x.shape, bool)
    height = 50.0 * normals[..., 2].astype(np.float64)
    images = shaded(normals, directions) * np.float32(0.6)
    camera = bench_camera(60, 50) if near else None
    return Recording("ball", images, lights, camera, mask, normals, height, uniform=uniform)


@pytest.mark.parametrize("name", [name for name in CASES if name not in (NONE, "vignetting")])
def test_every_strength_changes_a_recording(name):
    case, clean = CASES[name], ball(near=True)
    before = clean.images.copy()
    for strength in case.strengths:
        changed = case.change(clean, strength)
        places = np.ptp([clean.lights.intensities, changed.lights.intensities], axis=0).sum()
        if changed.lights.near:
            places += np.abs(changed.lights.positions_mm - clean.lights.positions_mm).sum()
        else:
            places += 1
        camera = np.abs(changed.camera.K - clean.camera.K).sum()
        camera += abs(changed.camera.working_distance_mm - clean.camera.working_distance_mm)
        images = np.abs(np.clip(changed.images, 0, 1) - clean.images).sum()
        assert images + places + camera > 0
    np.testing.assert_array_equal(clean.images, before)


@cases(
    ("name", "signs"),
    {"mirrored": ("mirrored", MIRROR), "upside_down": ("upside_down", HALF_TURN)},
)
def test_the_truth_of_turned_images_is_the_one_in_them(name, signs):
    changed = CASES[name].change(ball(), 1)
    directions = changed.lights.unit_directions * np.array(signs)
    np.testing.assert_allclose(changed.images, 0.6 * shaded(changed.normals, directions), atol=1e-6)


@pytest.mark.parametrize("near", [True, False], ids=["near", "distant"])
def test_lights_with_a_wrong_sign_shine_on_a_mirrored_object(near):
    clean = ball(near=near)
    lights = CASES["lights_y_sign"].change(clean, 1).lights
    points = np.array([[20.0, 30.0, 5.0]])
    np.testing.assert_allclose(
        lights.vectors_at(points * Y_SIGN), clean.lights.vectors_at(points) * Y_SIGN, rtol=1e-9
    )


@cases(
    ("name", "strength", "expected"),
    {
        "room light": ("room_light", 0.1, lambda v: v + 0.1 * v.mean(axis=0)),
        "black level": ("black_offset", 0.02, lambda v: v + 0.02),
        "fading": ("fading", 0.2, lambda v: v * np.linspace(1, 0.8, 9).reshape(-1, 1, 1)),
        "reversed": ("reversed", 1, lambda v: v[::-1]),
        "next light": ("order_shifted", 1, lambda v: v[[8, *range(8)]]),
        "half moved": (
            "half_moved",
            2,
            lambda v: np.concatenate([v[:4], v[4:][..., [0, 0, *range(58)]]]),
        ),
    },
)
def test_images_are_changed_as_stated(name, strength, expected):
    clean = ball()
    changed = CASES[name].change(clean, strength)
    np.testing.assert_allclose(changed.images, expected(clean.images), atol=1e-5)


def outcome(causes: str = "", error: float = 3.0, sigma: float = 0.5, answer: str = "check"):
    return Outcome(error_deg=error, change_deg=error, sigma_deg=sigma, answer=answer, causes=causes)


@cases(
    ("case", "causes", "near", "uniform", "named"),
    {
        "right": ("room_light", "ambient-light", True, False, True),
        "the second": ("room_light", "black-level ambient-light", True, False, True),
        "the third": ("room_light", "a b ambient-light", True, False, False),
        "an alternative": ("room_light", "black-level/ambient-light", True, False, True),
        "another": ("room_light", "black-level", True, False, False),
        "another that looks the same": ("room_light", "black-level", True, True, True),
        "gloss for a curve": ("power", "surface-not-matte", True, False, False),
        "gloss for a curve, far lights": ("power", "surface-not-matte", False, False, True),
        "nothing": ("drift", "", True, False, False),
        "one of two": ("drift+room_light", "ambient-light", True, False, True),
    },
)
def test_a_name_is_right_for_its_case(case, causes, near, uniform, named):
    key = Key("ball", "1", case, "1")
    row = Row.of(key, ball(near=near, uniform=uniform), outcome(causes))
    assert row.named == named


@cases(
    ("changed", "stated", "harms"),
    {
        "worse": (outcome(error=3.5), 0.5, True),
        "hardly worse": (outcome(error=2.9), 0.5, False),
        "as stated": (outcome(error=3.5), 2.0, False),
        "as stated of itself": (outcome(error=3.5, sigma=2), 0.5, True),
        "refused": (Outcome(), 0.5, True),
    },
)
def test_harm_exceeds_the_clean_error_by_more_than_is_stated_of_it(changed, stated, harms):
    clean = Row.of(
        Key("ball", "1", NONE, "0"), ball(), outcome(error=2, answer="good", sigma=stated)
    )
    row = Row.of(Key("ball", "1", "drift", "1"), ball(), changed)
    assert row.harms(clean) == harms


def test_objects_without_truth_are_compared_with_their_clean_result():
    clean = Row.of(Key("cat", "0", NONE, "0"), ball(), outcome(error=np.nan))
    changed = replace(outcome(error=np.nan), change_deg=4.0)
    assert Row.of(Key("cat", "0", "drift", "1"), ball(), changed).harms(clean)


@cases(
    ("text", "options", "keywords"),
    {
        "a person": ("repeat in the dark", "", {}),
        "ambient": (
            "repeat in the dark, or give --ambient estimate",
            "--ambient estimate",
            {"ambient": "estimate"},
        ),
        "distance": (
            "give --light-distance-mm 450.5",
            "--light-distance-mm 450.5",
            {"light_distance_mm": 450.5},
        ),
        "an estimate of it": (
            "give --light-distance-mm estimate, or measure it",
            "--light-distance-mm estimate",
            {"light_distance_mm": "estimate"},
        ),
        "no value": ("measure it, and give --light-distance-mm D", "", {}),
        "switch": ("use --semi-calibrated.", "--semi-calibrated", {"semi_calibrated": True}),
    },
)
def test_a_remedy_is_followed_if_it_is_an_option(text, options, keywords):
    remedy = Remedy.of(Cause("a", "b", 1.0, "", 0.1, 2.0, np.nan, text))
    assert (remedy.options, dict(remedy.keywords)) == (options, keywords)


def test_a_remedy_may_change_how_images_are_read():
    curve = Remedy.of(Cause("a", "b", 1.0, "", 0.1, 2.0, np.nan, "read with --gamma sRGB."))
    assert curve.transfer == SRGB
    less = Remedy.of(Cause("a", "b", 1.0, "", 0.1, 2.0, np.nan, "leave out: --exclude L01,L07."))
    assert less.without == ("L01", "L07")


def test_a_table_is_read_as_it_was_written(tmp_path):
    table = Table(tmp_path / "table.csv")
    text = 'refused, because "a"\nis not b'
    rows = [
        Row.of(Key("ball", "1", NONE, "0"), ball(), outcome(error=2.0)),
        Row.of(Key("ball", "1", "drift", "3"), ball(), Outcome(text=text)),
    ]
    for row in rows:
        table.add(row)
    again = Table(tmp_path / "table.csv")
    assert str(list(again.rows.values())) == str(rows)  # NaN equals nothing
    assert rows[1].key in again


@pytest.mark.slow
def test_the_command_adds_only_what_is_missing(tmp_path, capsys):
    file = tmp_path / "table.csv"
    words = ["--out", str(file), "--scenes", "coin", "--real", "--strengths", "1"]
    words += ["--size", "80", "64", "--cases", NONE, "half_moved"]
    assert command.main(words) == 0
    assert len(file.read_text().splitlines()) == 3
    before = file.read_bytes()
    capsys.readouterr()
    assert command.main([*words, "--minutes", "0"]) == 0
    assert file.read_bytes() == before
    assert "1 imperfect recordings" in capsys.readouterr().out
