"""Recording on the simulated rig as an operator does: complete, interrupted, damaged later."""

import json

import numpy as np
import pytest

import acquisition
from acquisition import Session, read_image
from tests.sgp.small_rig import WORLD_RIG, capture, events


@pytest.fixture
def dead_led(simulated_world, tmp_path):
    """A rig file of which LED 2 gives no light, although it is not listed as dead."""
    path = tmp_path / "rig.toml"
    path.write_text(WORLD_RIG + "[options.lamps]\ndead = [2]\n", encoding="utf-8")
    return path


def test_a_session_is_checked_recorded_verified_and_described(sgp, real_rig, plan, tmp_path):
    out = tmp_path / "session"
    words = ("--rig", real_rig, "--plan", plan(5000.0), "--object-name", "coin")
    more = ("--operator", "Ada", "--place", "hall 3", "--rights", "CC0", "--notes", "rim scratched")
    capture(sgp, out, *words, *more, check=True).ok()
    assert events(out) == ["checked", "camera_settings", "compared"]
    assert sgp("capture", "verify", out).code == 0
    info = sgp("capture", "info", out, "--frames")
    for text in ("coin, by Ada", "hall 3", "CC0", "rim scratched", "L05_E0.tif", "1 x checked"):
        assert text in info.out
    manifest = Session.open(out).manifest
    assert (manifest.place, manifest.rights) == ("hall 3", "CC0")
    assert capture(sgp, out, *words).code == 2, "a session is never overwritten"
    assert sgp("capture", "verify", out).code == 0


def test_a_failed_check_ends_it_before_anything_is_recorded(sgp, dead_led, tmp_path, plan):
    answer = capture(sgp, tmp_path / "s", "--rig", dead_led, "--plan", plan(5000.0), check=True)
    assert answer.code == 3
    assert "LED" in answer.err
    assert "2" in answer.err
    assert not (tmp_path / "s").exists()


@pytest.mark.slow
def test_an_led_that_gives_no_light_is_found_while_recording(sgp, dead_led, tmp_path, plan):
    answer = capture(sgp, tmp_path / "s", "--rig", dead_led, "--plan", plan(5000.0))
    assert answer.code == 3
    assert "LED 2 gave no light" in answer.err
    assert "the LEDs are off" in answer.err
    # If the LED is listed as dead, it is skipped with a warning.
    listed = tmp_path / "listed.toml"
    listed.write_text(WORLD_RIG.replace("leds = 6", "leds = 6\ndead_leds = [2]"), encoding="utf-8")
    out = tmp_path / "t"
    answer = capture(sgp, out, "--rig", listed, "--plan", plan(5000.0), "--json").ok()
    assert any("2" in line and "dead" in line for line in json.loads(answer.out)["warnings"])
    session = Session.open(out)
    assert session.complete
    assert sorted(f.led for f in session.frames if f.role == "light") == [0, 1, 3, 4, 5]
    left_out = next(line for line in session.events if line.event == "left_out")
    assert left_out.details == {"leds": [2], "reason": "listed as dead"}


def test_exposures_are_metered_and_the_metering_is_recorded(sgp, rig, plan, tmp_path):
    capture(sgp, tmp_path / "s", "--rig", rig, "--plan", plan(5000.0), "--meter", "one").ok()
    assert "metered" in events(tmp_path / "s")
    session = Session.open(tmp_path / "s")
    bright = [f.line.percentiles_dn["99"] for f in session.frames if f.role == "light"]
    assert max(bright) > 2000


def test_the_wiring_is_checked_before_metering(sgp, rig, tmp_path, plan, monkeypatch):
    rig.write_text(WORLD_RIG + "[options.wiring]\nalways = [3]\n", encoding="utf-8")
    monkeypatch.setattr(acquisition.metering, "meter", lambda *_, **__: pytest.fail("metered"))
    words = ("--rig", rig, "--plan", plan(5000.0), "--meter", "each")
    answer = capture(sgp, tmp_path / "s", *words, check=True)
    assert answer.code == 3, answer.err
    assert "checking the wiring of the LEDs" in answer.err
    assert "LED 3 is on when all should be off" in answer.err
    assert not (tmp_path / "s").exists()


def test_a_dead_led_passes_the_wiring_check_and_is_left_out_by_metering(
    sgp, dead_led, tmp_path, plan
):
    """The LEDs are tested once, and the result is recorded with the other checks."""
    words = ("--rig", dead_led, "--plan", plan(5000.0), "--meter", "each")
    answer = capture(sgp, tmp_path / "s", *words, check=True)
    session = Session.open(tmp_path / "s")
    events = [line.event for line in session.events]
    assert events == ["metered", "left_out", "checked", "compared"]
    checks = session.events[2].details["checks"]
    assert [check["state"] for check in checks if check["name"] == "LEDs"] == ["warning"]
    assert session.complete, answer.err


def test_an_led_without_light_in_the_metering_is_skipped(sgp, dead_led, tmp_path, plan):
    answer = capture(
        sgp, tmp_path / "s", "--rig", dead_led, "--plan", plan(5000.0), "--meter", "each"
    ).ok()
    assert "LED 2 gives no light" in answer.err
    assert events(tmp_path / "s")[:2] == ["metered", "left_out"]
    session = Session.open(tmp_path / "s")
    assert session.complete
    assert 2 not in [frame.led for frame in session.frames]


def test_a_dry_run_records_nothing_and_lights_nothing(sgp, rig, plan, tmp_path):
    metrics = capture(
        sgp, tmp_path / "s", "--rig", rig, "--plan", plan(5000.0), "--dry-run", "--json"
    ).figures()
    assert (metrics["shots"], metrics["recorded"]) == (8, False)
    assert metrics["bytes"] == 8 * 64 * 52 * 2
    assert not (tmp_path / "s").exists()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        pytest.param((), (99.5, 0.7, 0.005), id="default"),
        pytest.param(
            ("--meter-percentile", "90", "--meter-fraction", "0.3"),
            (90, 0.3, 0.005),
            id="lower",
            marks=pytest.mark.slow,
        ),
        pytest.param(("--max-clipped", "0"), (99.5, 0.7, 0.0), id="clipping"),
    ],
)
def test_the_metering_goal_can_be_set(sgp, rig, plan, tmp_path, words, expected):
    out = tmp_path / "s"
    capture(sgp, out, "--rig", rig, "--plan", plan(5000.0), "--meter", "each", *words).ok()
    metered = next(line for line in Session.open(out).events if line.event == "metered").details
    names = ("percentile", "fraction", "max_clipped_fraction")
    assert tuple(metered[name] for name in names) == expected
    for light in metered["lights"]:
        assert light["clipped_fraction"] <= expected[2]
        if light["state"] == "ok" and expected[0] == 90:
            assert light["level"] == pytest.approx(expected[1], rel=0.05)


@pytest.mark.parametrize(
    "words",
    [
        ("--meter-percentile", "50"),
        ("--meter-fraction", "0.5"),
        ("--max-clipped", "0"),
        ("--meter", "each", "--meter-percentile", "101"),
        ("--meter", "each", "--meter-fraction", "0"),
        ("--meter", "one", "--max-clipped", "1.5"),
    ],
)
def test_metering_options_are_checked(sgp, rig, plan, tmp_path, words):
    line = capture(sgp, tmp_path / "s", "--rig", rig, "--plan", plan(5000.0), *words).error_line(2)
    assert words[-2] in line
    assert not (tmp_path / "s").exists()


def test_a_contact_sheet_shows_every_frame(sgp, recorded, tmp_path):
    sheet = tmp_path / "sheet.png"
    answer = sgp("capture", "info", recorded, "--sheet", sheet, "--json")
    assert json.loads(answer.out)["outputs"]["sheet"] == str(sheet)
    picture = read_image(sheet)
    assert picture.dtype == np.uint8
    # Eight frames in rows of six, 200 px wide with the aspect ratio 52 / 64, two lines of text,
    # and the legend.
    assert picture.shape == (2 * (162 + 40 + 4) + 26, 6 * 204, 3)
    # The first is lit, the last is dark; clipped pixels would be red, but no pixel is clipped.
    assert picture[206:368, 204:404].mean() < 30 < picture[:162, :200].mean()
    assert (picture[:162, 204:404, 0] == picture[:162, 204:404, 1]).all()
    assert (picture[-13, 8] == (255, 60, 60)).all(), "the legend shows the colour of clipping"
    assert sgp("capture", "info", recorded, "--sheet", sheet).code == 2
    assert sgp("capture", "info", recorded, "--sheet", sheet, "--force").code == 0


def test_rig_commands(sgp, real_rig, tmp_path):
    assert "simulated" in sgp("rig", "list").out
    assert sgp("rig", "check", "--rig", real_rig, "--json").figures()["board"]["leds"] == 6
    assert sgp("rig", "off", "--rig", real_rig).code == 0
    assert sgp("rig", "light", 2, "--seconds", 0.05, "--rig", real_rig).code == 0
    assert sgp("rig", "light", 6, "--rig", real_rig).code == 2
    words = ("rig", "snap", "--rig", real_rig, "--led")
    assert sgp(*words, 1, "--out", tmp_path / "a.tif", "--json").figures()["p99_dn"] > 200
    assert sgp(*words, 9, "--out", tmp_path / "b.tif").code == 2
    assert not (tmp_path / "b.tif").exists()
