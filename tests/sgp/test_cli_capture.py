"""Recording on the simulated rig as an operator does: to the end, interrupted, damaged later."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from acquisition import Session, read_image

RIG = """
name = "small"
driver = "simulated"
leds = 6
[options]
scene = "coin"
width = 64
height = 52
seed = 3
"""
CAPTURE = [sys.executable, "-c", "from sgp import capture; capture()"]


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(RIG, encoding="utf-8")
    return path


@pytest.fixture
def plan(tmp_path: Path):
    def write(exposure_us: float) -> Path:
        path = tmp_path / "plan.toml"
        path.write_text(f"leds = [0,1,2,3,4,5]\nexposures_us = [{exposure_us}]\n", encoding="utf-8")
        return path

    return write


def capture(sgp, *words, **options):
    """Call ``sgp capture run`` without the checks that come first, unless they are wanted."""
    more = [] if options.pop("check", False) else ["--skip-check"]
    return sgp("capture", "run", *words, *more)


def events(folder):
    return [line.event for line in Session.open(folder).events if line.event != "paused"]


def test_a_session_is_checked_recorded_verified_and_told(sgp, rig, plan, tmp_path):
    out = tmp_path / "session"
    words = ("--rig", rig, "--plan", plan(5000.0), "--object-name", "coin", "--operator", "Ada")
    more = ("--place", "hall 3", "--rights", "CC0", "--notes", "rim scratched")
    answer = capture(sgp, out, *words, *more, check=True)
    assert answer.code == 0, answer.err
    assert events(out) == ["checked"]
    assert sgp("capture", "verify", out).code == 0
    told = sgp("capture", "info", out)
    for text in ("coin, by Ada", "hall 3", "CC0", "rim scratched", "L05_E0.tif", "1 x checked"):
        assert text in told.out
    manifest = Session.open(out).manifest
    assert (manifest.place, manifest.rights) == ("hall 3", "CC0")
    assert capture(sgp, out, *words).code == 2, "a session is never recorded over"
    assert sgp("capture", "verify", out).code == 0


def test_a_check_that_fails_ends_it_before_anything_is_recorded(sgp, tmp_path, plan):
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG + "[options.lamps]\ndead = [2]\n", encoding="utf-8")
    answer = capture(sgp, tmp_path / "s", "--rig", rig, "--plan", plan(5000.0), check=True)
    assert answer.code == 3
    assert "LED" in answer.err
    assert "2" in answer.err
    assert not (tmp_path / "s").exists()


def test_an_led_that_gives_no_light_is_found_while_recording(sgp, tmp_path, plan):
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG + "[options.lamps]\ndead = [2]\n", encoding="utf-8")
    answer = capture(sgp, tmp_path / "s", "--rig", rig, "--plan", plan(5000.0))
    assert answer.code == 3
    assert "LED 2 gave no light" in answer.err
    assert "the LEDs are off" in answer.err
    # Listed as dead it is left out, which is told.
    listed = tmp_path / "listed.toml"
    listed.write_text(RIG.replace("leds = 6", "leds = 6\ndead_leds = [2]"), encoding="utf-8")
    out = tmp_path / "t"
    answer = capture(sgp, out, "--rig", listed, "--plan", plan(5000.0), "--json")
    assert answer.code == 0
    assert any("2" in line and "dead" in line for line in json.loads(answer.out)["warnings"])
    session = Session.open(out)
    assert session.complete
    assert sorted(f.led for f in session.frames if f.role == "light") == [0, 1, 3, 4, 5]
    left_out = next(line for line in session.events if line.event == "left_out")
    assert left_out.details == {"leds": [2], "reason": "listed as dead"}


def test_exposures_are_metered_and_the_metering_is_recorded(sgp, rig, plan, tmp_path):
    answer = capture(sgp, tmp_path / "s", "--rig", rig, "--plan", plan(5000.0), "--meter", "one")
    assert answer.code == 0, answer.err
    assert "metered" in events(tmp_path / "s")
    session = Session.open(tmp_path / "s")
    bright = [f.line.percentiles_dn["99"] for f in session.frames if f.role == "light"]
    assert max(bright) > 2000


def test_an_led_that_is_dead_to_the_meter_is_left_out(sgp, tmp_path, plan):
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG + "[options.lamps]\ndead = [2]\n", encoding="utf-8")
    answer = capture(sgp, tmp_path / "s", "--rig", rig, "--plan", plan(5000.0), "--meter", "each")
    assert answer.code == 0, answer.err
    assert "LED 2 gives no light" in answer.err
    assert events(tmp_path / "s")[:2] == ["metered", "left_out"]
    session = Session.open(tmp_path / "s")
    assert session.complete
    assert 2 not in [frame.led for frame in session.frames]


def test_a_dry_run_records_nothing_and_lights_nothing(sgp, rig, plan, tmp_path):
    answer = capture(
        sgp, tmp_path / "s", "--rig", rig, "--plan", plan(5000.0), "--dry-run", "--json"
    )
    assert answer.code == 0, answer.err
    metrics = json.loads(answer.out)["metrics"]
    assert (metrics["shots"], metrics["recorded"]) == (7, False)
    assert metrics["bytes"] == 7 * 64 * 52 * 2
    assert not (tmp_path / "s").exists()


def test_flats_wait_for_the_card(sgp, rig, tmp_path):
    """Without a terminal to ask at, the recording stops before them and resume takes them."""
    plan = tmp_path / "flats.toml"
    plan.write_text("leds = [0, 1, 2]\nexposures_us = [5000]\nflats = 3\n", encoding="utf-8")
    answer = capture(sgp, tmp_path / "s", "--rig", rig, "--plan", plan)
    assert answer.code == 2
    assert "put the white card under the camera" in answer.err
    missing = Session.open(tmp_path / "s").missing
    assert [shot.role for shot in missing] == ["flat"] * 3
    assert sgp("capture", "resume", tmp_path / "s", "--rig", rig).code == 0
    assert sgp("capture", "verify", tmp_path / "s").code == 0


def test_a_contact_sheet_shows_every_frame(sgp, rig, plan, tmp_path):
    out, sheet = tmp_path / "session", tmp_path / "sheet.png"
    assert capture(sgp, out, "--rig", rig, "--plan", plan(5000.0)).code == 0
    answer = sgp("capture", "info", out, "--sheet", sheet, "--json")
    assert json.loads(answer.out)["outputs"]["sheet"] == str(sheet)
    picture = read_image(sheet)
    assert picture.dtype == np.uint8
    # Seven frames in rows of six, 200 px wide and as high as 52 / 64 asks for, and their names.
    assert picture.shape == (2 * (162 + 22 + 4), 6 * 204, 3)
    # The first one is dark, the second is not; red marks what is clipped, and nothing is.
    assert picture[:162, :200].mean() < 30 < picture[:162, 204:404].mean()
    assert (picture[:162, 204:404, 0] == picture[:162, 204:404, 1]).all()
    assert sgp("capture", "info", out, "--sheet", sheet).code == 2
    assert sgp("capture", "info", out, "--sheet", sheet, "--force").code == 0


def test_verify_names_the_frame_that_one_bit_changed(sgp, rig, plan, tmp_path):
    out = tmp_path / "session"
    assert capture(sgp, out, "--rig", rig, "--plan", plan(5000.0)).code == 0
    frame = out / "frames" / "L03_E0.tif"
    data = bytearray(frame.read_bytes())
    data[len(data) // 2] ^= 1
    frame.write_bytes(data)
    answer = sgp("capture", "verify", out, "--json")
    assert answer.code == 4
    problems = json.loads(answer.out)["metrics"]["problems"]
    assert len(problems) == 1
    assert "L03_E0.tif" in problems[0]


def test_ctrl_c_leaves_a_dark_rig_and_a_whole_incomplete_session(sgp, rig, plan, tmp_path):
    out = tmp_path / "session"
    process = subprocess.Popen(
        [*CAPTURE, "run", str(out), *("--rig", rig), *("--plan", plan(200_000.0)), "--skip-check"],
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"NUMBA_NUM_THREADS": "1"},
    )
    frames = out / "frames"
    deadline = time.monotonic() + 60
    while not (frames / "L01_E0.tif").exists():
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=20)
    assert process.returncode == 130, said
    assert "Ctrl-C" in said
    assert "incomplete" in said
    assert "Traceback" not in said
    session = Session.open(out)
    assert not session.complete
    assert 0 < len(session.missing) < 7
    assert "the LEDs are off" in said
    assert "stopping after this shot" in said
    assert events(out) == ["interrupted"]
    assert session.events[-1].details["leds_confirmed_off"] is True
    answer = sgp("capture", "verify", out, "--json")
    assert answer.code == 4
    found = json.loads(answer.out)["metrics"]
    assert found["whole"] is True
    assert found["complete"] is False
    # Another rig is refused; this one takes what is missing.
    other = tmp_path / "other.toml"
    other.write_text(RIG.replace("width = 64", "width = 72"), encoding="utf-8")
    answer = sgp("capture", "resume", out, "--rig", other)
    assert answer.code == 4
    assert "camera width was 64 and is 72" in answer.err
    answer = sgp("capture", "resume", out, "--rig", rig, "--plan", plan(100_000.0))
    assert answer.code == 4
    assert "plan exposures_us was (200000.0,) and is (100000.0,)" in answer.err
    before = [frame.line for frame in session.frames]
    answer = sgp("capture", "resume", out, "--rig", rig, "--dry-run", "--json")
    assert json.loads(answer.out)["metrics"]["shots"] == len(session.missing)
    assert Session.open(out).events == session.events
    assert sgp("capture", "resume", out, "--rig", rig).code == 0
    assert [frame.line for frame in Session.open(out).frames][: len(before)] == before
    assert sgp("capture", "verify", out).code == 0
    answer = sgp("capture", "resume", out, "--rig", rig)
    assert answer.code == 4
    assert "is complete" in answer.err


def test_what_cannot_be_resumed(sgp, rig, tmp_path):
    assert sgp("capture", "resume", tmp_path / "none", "--rig", rig).code == 2
    (tmp_path / "empty").mkdir()
    assert sgp("capture", "resume", tmp_path / "empty", "--rig", rig).code == 4


def test_rig_commands(sgp, rig, tmp_path):
    assert "simulated" in sgp("rig", "list").out
    checked = sgp("rig", "check", "--rig", rig, "--json")
    assert json.loads(checked.out)["metrics"]["board"]["leds"] == 6
    assert sgp("rig", "off", "--rig", rig).code == 0
    assert sgp("rig", "light", 2, "--seconds", 0.05, "--rig", rig).code == 0
    assert sgp("rig", "light", 6, "--rig", rig).code == 2
    snapped = sgp("rig", "snap", "--led", 1, "--rig", rig, "--out", tmp_path / "a.tif", "--json")
    assert json.loads(snapped.out)["metrics"]["p99_dn"] > 200
    assert sgp("rig", "snap", "--led", 9, "--rig", rig, "--out", tmp_path / "b.tif").code == 2
    assert not (tmp_path / "b.tif").exists()
