"""Calibrations record their setup; processing and the rig file contradict those of another one."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from acquisition import Session, read_lights
from sgp.app import build, run
from sgp.rigs import led_positions, rig_notices


@pytest.fixture(scope="module")
def spheres(tmp_path_factory):
    """A session of a simulated rig with four chrome spheres under eight LEDs."""
    out = tmp_path_factory.mktemp("scene") / "spheres"
    words = ["simulate", "spheres", "--size", "480x384", "--led-count", "8", "--out", str(out)]
    assert run(build(), words) == 0
    return out


@pytest.fixture(scope="module")
def lights(spheres):
    out = spheres.parent / "lights.json"
    words = ["calibrate", "spheres", str(spheres), "--radius-mm", "20", "--out", str(out)]
    assert run(build(), words) == 0
    return out


def rig_file(path, spheres, swap=()):
    truth = read_lights(spheres / "derived" / "truth" / "lights.json").positions_mm
    rows = np.round(truth).tolist()
    for one, other in [swap] if swap else []:
        rows[one], rows[other] = rows[other], rows[one]
    name = Session.open(spheres).manifest.rig.name
    path.write_text(
        f'name = "{name}"\ndriver = "bench"\nleds = {len(rows)}\nled_positions_mm = {rows}\n'
    )
    return path


def test_a_calibration_records_its_setup(spheres, lights):
    manifest = Session.open(spheres).manifest
    calibrated = read_lights(lights).calibrated
    assert calibrated.time_utc == manifest.started_utc
    assert calibrated.setup.rig == manifest.rig.name
    assert calibrated.setup.camera_model == manifest.camera.model
    assert calibrated.setup.camera_serial == manifest.camera.serial
    np.testing.assert_array_equal(calibrated.setup.intrinsics.K, manifest.camera_model.K)
    assert len(calibrated.spheres) >= 2
    assert {sphere.radius_mm for sphere in calibrated.spheres} == {20}


@pytest.mark.parametrize(
    ("change", "code"),
    [
        pytest.param(None, None, id="same", marks=pytest.mark.slow),
        pytest.param(
            ("rig", "another dome"), "lights-of-another-rig", id="rig", marks=pytest.mark.slow
        ),
        pytest.param(
            ("camera", {"model": "virtual camera", "serial": "0815"}),
            "lights-of-another-camera",
            id="camera",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_normals_warn_about_lights_of_another_setup(sgp, spheres, lights, tmp_path, change, code):
    file = json.loads(lights.read_text())
    if change is not None:
        file["calibrated"][change[0]] = change[1]
    (tmp_path / "l.json").write_text(json.dumps(file))
    words = ("normals", spheres, "--lights", tmp_path / "l.json", "--out", tmp_path / "n")
    codes = sgp(*words, "--method", "ls", "--downscale", 4, "--json").codes()
    expected = [] if code is None else [code]
    assert [one for one in codes if one.startswith("lights-of-another")] == expected


@pytest.mark.slow
def test_lights_that_contradict_the_configured_rig_file_are_named(
    sgp, spheres, tmp_path, monkeypatch
):
    monkeypatch.setenv("SGP_RIG", str(rig_file(tmp_path / "rig.toml", spheres, (2, 5))))
    words = ("calibrate", "spheres", spheres, "--radius-mm", 20, "--out", tmp_path / "l.json")
    said = " ".join(sgp(*words).ok().err.split())
    assert "warning: rig simulated: LED 2 and 5 are swapped" in said


def test_which_rig_file_counts(spheres, lights, tmp_path, monkeypatch):
    found = read_lights(lights)
    good = rig_file(tmp_path / "good.toml", spheres)
    swapped = rig_file(tmp_path / "swapped.toml", spheres, (2, 5))

    def codes(option, recorded_on, value=found):
        return [notice.code for notice in rig_notices(value, option, recorded_on)]

    assert codes(None, "simulated") == []
    assert codes(good, "") == []
    assert codes(swapped, "") == ["lights-swapped"]
    assert codes(swapped, "", found.distant()) == ["lights-swapped"]
    monkeypatch.setenv("SGP_RIG", str(swapped))
    assert codes(None, "simulated") == ["lights-swapped"]
    assert codes(good, "simulated") == []
    assert codes(None, "another") == []
    assert codes(None, "") == []
    assert codes(None, "simulated", replace(found, ids=tuple("abcdefgh"))) == []
    monkeypatch.setenv("SGP_RIG", str(tmp_path / "none.toml"))
    assert codes(None, "simulated") == []


def test_the_places_of_leds_come_from_the_rig_file(spheres, tmp_path, monkeypatch):
    good = rig_file(tmp_path / "good.toml", spheres)
    truth = read_lights(spheres / "derived" / "truth" / "lights.json")
    places = led_positions(good, "")
    assert tuple(places) == truth.ids
    np.testing.assert_allclose(list(places.values()), truth.positions_mm, atol=0.5)
    monkeypatch.setenv("SGP_RIG", str(good))
    assert led_positions(None, "simulated") == places
    assert led_positions(None, "another") == {}


@pytest.mark.slow
def test_the_rig_file_decides_that_the_radius_is_wrong(sgp, spheres, tmp_path):
    words = ("calibrate", "spheres", spheres, "--radius-mm", 21, "--out", tmp_path / "l.json")
    undecided = " ".join(sgp(*words).err.split())
    assert re.search(r"radius (19\.9|20\.0)", undecided)
    assert "or working distance 6" in undecided
    rig = rig_file(tmp_path / "rig.toml", spheres)
    decided = " ".join(sgp(*words, "--force", "--rig", rig).err.split())
    assert re.search(r"radius (19\.9|20\.0)", decided)
    assert "led_positions_mm exclude working distance 6" in decided


def test_a_rig_without_positions_is_refused_before_reading(sgp, spheres, tmp_path):
    (tmp_path / "bare.toml").write_text('name = "bare"\ndriver = "bench"\n')
    words = ("calibrate", "spheres", spheres, "--out", tmp_path / "l.json")
    assert "has no led_positions_mm" in sgp(*words, "--rig", tmp_path / "bare.toml").error_line(2)
    assert "none.toml" in sgp(*words, "--rig", tmp_path / "none.toml").error_line(2)
