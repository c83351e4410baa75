"""Recording on the simulated rig as an operator does: complete, interrupted, damaged later."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import closing
from itertools import product
from pathlib import Path

import numpy as np
import pytest

import acquisition
from acquisition import Session, read_image
from acquisition._session.writer import SessionWriter
from tests.acquisition.mutants import rows_of, seal
from tests.quick_sample import quick

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


@pytest.fixture
def with_flats(tmp_path: Path) -> Path:
    path = tmp_path / "flats.toml"
    path.write_text("leds = [0, 1, 2]\nexposures_us = [5000]\nflats = 3\n", encoding="utf-8")
    return path


def capture(sgp, *words, **options):
    """Call ``sgp capture run``, without the checks before the recording unless requested."""
    more = [] if options.pop("check", False) else ["--skip-check"]
    return sgp("capture", "run", *words, *more)


def events(folder):
    return [line.event for line in Session.open(folder).events if line.event != "paused"]


def test_a_session_is_checked_recorded_verified_and_described(sgp, rig, plan, tmp_path):
    out = tmp_path / "session"
    words = ("--rig", rig, "--plan", plan(5000.0), "--object-name", "coin", "--operator", "Ada")
    more = ("--place", "hall 3", "--rights", "CC0", "--notes", "rim scratched")
    answer = capture(sgp, out, *words, *more, check=True)
    assert answer.code == 0, answer.err
    assert events(out) == ["checked"]
    assert sgp("capture", "verify", out).code == 0
    info = sgp("capture", "info", out, "--frames")
    for text in ("coin, by Ada", "hall 3", "CC0", "rim scratched", "L05_E0.tif", "1 x checked"):
        assert text in info.out
    manifest = Session.open(out).manifest
    assert (manifest.place, manifest.rights) == ("hall 3", "CC0")
    assert capture(sgp, out, *words).code == 2, "a session is never overwritten"
    assert sgp("capture", "verify", out).code == 0


def test_a_failed_check_ends_it_before_anything_is_recorded(sgp, tmp_path, plan):
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
    # If the LED is listed as dead, it is skipped with a warning.
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


def test_the_wiring_is_checked_before_metering(sgp, tmp_path, plan, monkeypatch):
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG + "[options.wiring]\nalways = [3]\n", encoding="utf-8")
    monkeypatch.setattr(acquisition, "meter", lambda *_, **__: pytest.fail("metered"))
    words = ("--rig", rig, "--plan", plan(5000.0), "--meter", "each")
    answer = capture(sgp, tmp_path / "s", *words, check=True)
    assert answer.code == 3, answer.err
    assert "checking the wiring of the LEDs" in answer.err
    assert "LED 3 is on when all should be off" in answer.err
    assert not (tmp_path / "s").exists()


def test_a_dead_led_passes_the_wiring_check_and_is_left_out_by_metering(sgp, tmp_path, plan):
    """The LEDs are tested once, and the result is recorded with the other checks."""
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG + "[options.lamps]\ndead = [2]\n", encoding="utf-8")
    words = ("--rig", rig, "--plan", plan(5000.0), "--meter", "each")
    answer = capture(sgp, tmp_path / "s", *words, check=True)
    session = Session.open(tmp_path / "s")
    assert [line.event for line in session.events] == ["metered", "left_out", "checked"]
    checks = session.events[2].details["checks"]
    assert [check["state"] for check in checks if check["name"] == "LEDs"] == ["warning"]
    assert session.complete, answer.err


def test_an_led_without_light_in_the_metering_is_skipped(sgp, tmp_path, plan):
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


def test_flats_wait_for_the_card(sgp, rig, with_flats, tmp_path):
    """Without a terminal the recording stops before the flats, and resume takes them."""
    answer = capture(sgp, tmp_path / "s", "--rig", rig, "--plan", with_flats)
    assert answer.code == 2
    assert "put the white card under the camera" in answer.err
    missing = Session.open(tmp_path / "s").missing
    assert [shot.role for shot in missing] == ["flat"] * 3
    assert sgp("capture", "resume", tmp_path / "s", "--rig", rig).code == 0
    assert sgp("capture", "verify", tmp_path / "s").code == 0


def at_the_prompt(rig, plan, out, act, typed_before=b""):
    """Record at a terminal and act at the prompt for the card; return exit code and output."""
    mine, its = os.openpty()
    os.write(mine, typed_before)
    words = [*CAPTURE, "run", str(out), "--rig", rig, "--plan", plan, "--skip-check"]
    env = os.environ | {"NUMBA_NUM_THREADS": "1"}
    with subprocess.Popen(words, stdin=its, stderr=subprocess.PIPE, text=True, env=env) as process:
        try:
            for line in process.stderr:
                if "press Enter" in line:
                    act(process, mine)
                    break
            _, message = process.communicate(timeout=30)
        finally:
            process.kill()
            os.close(mine)
            os.close(its)
    return process.returncode, message


@pytest.mark.skipif(sys.platform == "win32", reason="requires a pty for the prompt")
def test_one_ctrl_c_ends_the_wait_for_the_card(sgp, rig, with_flats, tmp_path):
    out = tmp_path / "s"
    code, message = at_the_prompt(
        rig, with_flats, out, lambda process, _: process.send_signal(signal.SIGINT)
    )
    assert code == 130, message
    assert "stopping after this shot" in message
    assert "the LEDs are off" in message
    assert [shot.role for shot in Session.open(out).missing] == ["flat"] * 3
    assert sgp("capture", "resume", out, "--rig", rig).code == 0


@pytest.mark.skipif(sys.platform == "win32", reason="requires a pty for the prompt")
def test_enter_takes_the_flats(rig, with_flats, tmp_path):
    out = tmp_path / "s"

    def press(process, terminal):
        assert not any(frame.role == "flat" for frame in Session.open(out).recorded)
        os.write(terminal, b"\n")

    code, message = at_the_prompt(rig, with_flats, out, press)
    assert code == 0, message
    assert Session.open(out).complete


def leave_it(process, terminal):
    time.sleep(1)  # enough time for three flats of 5 ms
    process.send_signal(signal.SIGINT)


@pytest.mark.skipif(sys.platform == "win32", reason="requires a pty for the prompt")
@pytest.mark.parametrize(
    ("typed_before", "act", "code"),
    [
        pytest.param(b"\n\n", leave_it, 130, id="Enter"),
        pytest.param(
            b"",
            lambda _, terminal: os.write(terminal, b"\x04"),
            2,
            id="Ctrl-D",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_only_enter_at_the_prompt_takes_the_flats(
    rig, with_flats, tmp_path, typed_before, act, code
):
    """Neither an Enter before the prompt nor the end of the input counts."""
    out = tmp_path / "s"
    ended, message = at_the_prompt(rig, with_flats, out, act, typed_before)
    assert ended == code, message
    assert [shot.role for shot in Session.open(out).missing] == ["flat"] * 3


def test_an_led_that_dies_while_recording_is_listed_and_the_rest_completed(sgp, tmp_path, plan):
    rig, out = tmp_path / "rig.toml", tmp_path / "s"
    lamps = "[options.lamps]\ndead = [2]\n"
    rig.write_text(RIG + lamps, encoding="utf-8")
    planned = plan(5000.0)
    assert capture(sgp, out, "--rig", rig, "--plan", planned).code == 3
    rig.write_text(RIG.replace("leds = 6", "leds = 6\ndead_leds = [2]") + lamps, encoding="utf-8")
    missing = len(Session.open(out).missing)
    answer = sgp("capture", "resume", out, "--rig", rig, "--plan", planned, "--dry-run", "--json")
    assert json.loads(answer.out)["metrics"]["shots"] == missing - 1
    answer = sgp("capture", "resume", out, "--rig", rig, "--plan", planned)
    assert answer.code == 0, answer.err
    assert "LED 2 died: 1 shot skipped" in answer.err
    assert sorted(f.led for f in Session.open(out).frames if f.role == "light") == [0, 1, 3, 4, 5]
    answer = sgp("capture", "verify", out)
    assert answer.code == 0
    assert "1 planned frame was skipped because its LED died: L02_E0.tif" in answer.out
    assert "LED 2 died" in sgp("capture", "info", out).err


def test_resuming_checks_disk_and_rig_first(sgp, rig, with_flats, tmp_path, monkeypatch):
    out = tmp_path / "s"
    assert capture(sgp, out, "--rig", rig, "--plan", with_flats).code == 2
    before = (out / "journal.jsonl").read_bytes()
    usage = shutil.disk_usage(tmp_path)
    with monkeypatch.context() as full:
        full.setattr(shutil, "disk_usage", lambda path: usage._replace(free=1000))
        answer = sgp("capture", "resume", out, "--rig", rig)
        assert answer.code == 3
        assert "the check before recording failed: disk: " in answer.err
        assert (out / "journal.jsonl").read_bytes() == before
        assert sgp("capture", "resume", out, "--rig", rig, "--skip-check", "--dry-run").code == 0
    assert sgp("capture", "resume", out, "--rig", rig).code == 0
    checked = next(line for line in Session.open(out).events if line.event == "checked")
    assert [(check["name"], check["state"]) for check in checked.details["checks"]] == [
        (name, "ok") for name in ("disk", "board", "camera", "brightness")
    ]
    # Three flats of 64 x 52 pixels with 16 bits, plus a quarter.
    assert checked.details["checks"][0]["needed_bytes"] == 1.25 * 3 * 64 * 52 * 2


def test_resuming_without_the_checks_writes_no_checked_event(sgp, rig, with_flats, tmp_path):
    out = tmp_path / "s"
    assert capture(sgp, out, "--rig", rig, "--plan", with_flats).code == 2
    assert sgp("capture", "resume", out, "--rig", rig, "--skip-check").code == 0
    assert "checked" not in events(out)


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
    answer = capture(sgp, out, "--rig", rig, "--plan", plan(5000.0), "--meter", "each", *words)
    assert answer.code == 0, answer.err
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
    answer = capture(sgp, tmp_path / "s", "--rig", rig, "--plan", plan(5000.0), *words)
    assert answer.code == 2
    assert words[-2] in answer.err
    assert not (tmp_path / "s").exists()


def test_an_interrupted_compaction_is_reported(sgp, rig, plan, tmp_path):
    out = tmp_path / "s"
    assert capture(sgp, out, "--rig", rig, "--plan", plan(5000.0)).code == 0
    (out / "derived").mkdir(exist_ok=True)
    (out / "COMPLETE").rename(out / "derived" / "COMPLETE")
    message = "a compaction was interrupted: compact the session again"
    answer = sgp("capture", "verify", out)
    assert answer.code == 4
    assert message in answer.err
    assert message in sgp("capture", "info", out).err
    assert sgp("capture", "compact", out).code == 0
    assert message not in sgp("capture", "verify", out).err


def test_a_contact_sheet_shows_every_frame(sgp, rig, plan, tmp_path):
    out, sheet = tmp_path / "session", tmp_path / "sheet.png"
    assert capture(sgp, out, "--rig", rig, "--plan", plan(5000.0)).code == 0
    answer = sgp("capture", "info", out, "--sheet", sheet, "--json")
    assert json.loads(answer.out)["outputs"]["sheet"] == str(sheet)
    picture = read_image(sheet)
    assert picture.dtype == np.uint8
    # Seven frames in rows of six, 200 px wide with the aspect ratio 52 / 64, two lines of text,
    # and the legend.
    assert picture.shape == (2 * (162 + 40 + 4) + 26, 6 * 204, 3)
    # The first is lit, the last is dark; clipped pixels would be red, but no pixel is clipped.
    assert picture[206:368, :200].mean() < 30 < picture[:162, :200].mean()
    assert (picture[:162, 204:404, 0] == picture[:162, 204:404, 1]).all()
    assert (picture[-13, 8] == (255, 60, 60)).all(), "the legend shows the colour of clipping"
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


def flip(path):
    data = path.read_bytes()
    path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))


def test_resume_names_damage_and_retakes_it_when_asked(sgp, rig, with_flats, tmp_path):
    out = tmp_path / "s"
    assert capture(sgp, out, "--rig", rig, "--plan", with_flats).code == 2  # the card is missing
    flip(out / "frames" / "L01_E0.tif")
    (out / "frames" / "L02_E0.tif").unlink()
    damaged = (out / "frames" / "L01_E0.tif").read_bytes()
    words = ("capture", "resume", out, "--rig", rig, "--skip-check")
    answer = sgp(*words)
    assert answer.code == 4
    error = answer.err.splitlines()[-1]
    assert error.startswith(f"error: {out / 'frames' / 'L01_E0.tif'}: was changed since")
    assert "2 frames are damaged" in error
    assert (
        f"damaged: {out / 'frames' / 'L02_E0.tif'}: is in the journal but not there" in answer.err
    )
    again = f"capture resume {out} --rig {rig} --skip-check --retake-damaged"
    assert f"`{again}` takes" in answer.err
    assert not (out / "COMPLETE").exists()
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    answer = sgp(*words, "--retake-damaged", "--dry-run", "--json")
    assert (answer.code, json.loads(answer.out)["metrics"]["shots"]) == (0, 2)
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before
    answer = sgp(*words, "--retake-damaged", "--json")
    assert answer.code == 0
    report = json.loads(answer.out)["metrics"]
    assert report["complete"]
    assert report["set_aside"] == ["frames/L01_E0.tif", "frames/L02_E0.tif"]
    assert "set aside: frames/L01_E0.tif, kept as derived/set_aside/000_L01_E0.tif" in answer.err
    assert (out / "derived/set_aside/000_L01_E0.tif").read_bytes() == damaged
    assert sgp("capture", "verify", out).code == 0
    assert "2 damaged and set aside" in sgp("capture", "info", out).out


def test_a_complete_session_with_a_damaged_frame_is_repaired(sgp, rig, plan, tmp_path):
    out = tmp_path / "s"
    assert capture(sgp, out, "--rig", rig, "--plan", plan(5000.0)).code == 0
    words = ("capture", "resume", out, "--rig", rig, "--skip-check")
    assert "no frame is damaged" in sgp(*words, "--retake-damaged").err
    flip(out / "frames" / "D_5000us.tif")
    answer = sgp("capture", "verify", out)
    assert answer.code == 4
    assert f"`capture resume {out} --retake-damaged`, with --rig, takes" in answer.out
    assert "no shot is missing" in sgp(*words).err
    assert sgp(*words, "--retake-damaged").code == 0
    assert sgp("capture", "verify", out).code == 0


def test_a_frame_line_of_another_led_is_named_and_can_be_retaken(sgp, rig, plan, tmp_path):
    out = tmp_path / "s"
    assert capture(sgp, out, "--rig", rig, "--plan", plan(5000.0)).code == 0
    rows = rows_of(out)
    next(row for row in rows if row.get("led") == 3)["echo"]["led"] = 5
    seal(out, rows)
    message = "L03_E0.tif was planned with LED 3, but the LED board reports LED 5"
    words = ("capture", "resume", out, "--rig", rig, "--skip-check")
    for command in (
        ("capture", "info", out),
        ("sgp", "normals", out, "--out", tmp_path / "n"),
        words,
    ):
        line = sgp(*command[command[0] == "sgp" :]).error_line(4)
        assert message in line
    again = f"capture resume {out} --rig {rig} --skip-check --retake-damaged"
    assert line.endswith(f"`{again}` takes it again")
    assert sgp(*words, "--retake-damaged").code == 0
    assert sgp("capture", "verify", out).code == 0


def test_missing_lines_are_reported(sgp, rig, plan, tmp_path):
    out = tmp_path / "s"
    assert capture(sgp, out, "--rig", rig, "--plan", plan(5000.0)).code == 0
    seal(out, rows_of(out)[:4], complete=False)
    hint = "4 files without a line in the journal"
    for words in (
        ("verify", out),
        ("info", out),
        ("resume", out, "--rig", rig, "--skip-check"),
    ):
        answer = sgp("capture", *words)
        assert hint in answer.err + answer.out
        assert "restore journal.jsonl and COMPLETE from a copy before you continue" in (
            answer.err + answer.out
        )
    assert len(list((out / "derived" / "unrecorded").iterdir())) == 4


def test_ctrl_c_leaves_a_dark_rig_and_an_intact_incomplete_session(sgp, rig, plan, tmp_path):
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
    _, message = process.communicate(timeout=20)
    assert process.returncode == 130, message
    assert "Ctrl-C" in message
    assert "incomplete" in message
    assert "Traceback" not in message
    session = Session.open(out)
    assert not session.complete
    assert 0 < len(session.missing) < 7
    assert "the LEDs are off" in message
    assert "stopping after this shot" in message
    assert events(out) == ["interrupted"]
    assert session.events[-1].details["leds_confirmed_off"] is True
    answer = sgp("capture", "verify", out, "--json")
    assert answer.code == 4
    found = json.loads(answer.out)["metrics"]
    assert found["whole"] is True
    assert found["complete"] is False
    # Another rig is refused; the same rig takes the missing shots.
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
    journal = (out / "journal.jsonl").read_bytes()
    answer = sgp("capture", "resume", out, "--rig", rig)
    assert answer.code == 0
    assert "already complete: no shot is missing" in answer.err
    assert (out / "journal.jsonl").read_bytes() == journal


def test_a_torn_last_line_is_reported_on_resuming_and_its_frame_taken_again(
    sgp, rig, plan, tmp_path
):
    out = tmp_path / "s"
    assert capture(sgp, out, "--rig", rig, "--plan", plan(5000.0)).code == 0
    (out / "COMPLETE").unlink()
    journal = (out / "journal.jsonl").read_bytes()
    (out / "journal.jsonl").write_bytes(journal[:-40])
    answer = sgp("capture", "resume", out, "--rig", rig, "--skip-check")
    assert answer.code == 0, answer.err
    assert answer.err.count("writing the last line was interrupted") == 1
    assert "missing shots that have been taken: 1" in answer.err
    assert sgp("capture", "verify", out).code == 0


def test_a_second_writer_is_refused_in_one_line_that_claims_nothing(sgp, rig, with_flats, tmp_path):
    out = tmp_path / "s"
    assert capture(sgp, out, "--rig", rig, "--plan", with_flats).code == 2
    with closing(SessionWriter.reopen(out)):
        answer = sgp("capture", "resume", out, "--rig", rig, "--skip-check")
    assert answer.code == 3
    assert "another process is recording into this session" in answer.err
    assert answer.err.count("\n") == 1


def test_folders_that_cannot_be_resumed(sgp, rig, tmp_path):
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


@pytest.fixture(
    params=[
        "a full disk",
        *(
            pytest.param(kind, marks=pytest.mark.slow)
            for kind in ("a reader that has exited", "none")
        ),
    ]
)
def deaf(request):
    """A stderr that cannot be written, as an argument of `subprocess.run`."""
    if sys.platform == "win32":
        pytest.skip("has neither /dev/full nor descriptors that a child inherits closed")
    if request.param == "none":
        yield {"preexec_fn": lambda: os.close(2)}
        return
    if request.param == "a full disk":
        descriptor = os.open("/dev/full", os.O_WRONLY)
    else:
        reader, descriptor = os.pipe()
        os.close(reader)
    yield {"stderr": descriptor}
    os.close(descriptor)


def test_a_recording_does_not_end_because_its_log_cannot_be_written(deaf, rig, plan, tmp_path):
    out = tmp_path / "session"
    words = ("run", out, "--rig", rig, "--plan", plan(5000.0), "--json")
    ended = subprocess.run([*CAPTURE, *words], stdout=subprocess.PIPE, check=False, **deaf)
    assert ended.returncode == 0
    assert json.loads(ended.stdout)["ok"] is True
    assert Session.open(out).complete


def test_the_exit_code_of_an_error_is_right_even_if_it_cannot_be_printed(deaf, tmp_path):
    words = ("verify", tmp_path / "none", "--json")
    ended = subprocess.run([*CAPTURE, *words], stdout=subprocess.PIPE, check=False, **deaf)
    report = json.loads(ended.stdout)
    assert (report["ok"], report["exit_code"], ended.returncode) == (False, 2, 2)


def _pipe(path):
    path.unlink()
    os.mkfifo(path)


def _zero(path):
    path.unlink()
    path.symlink_to("/dev/zero")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such files")
@pytest.mark.parametrize(
    ("replaced", "name"),
    quick(
        product((_pipe, _zero), ("session.toml", "journal.jsonl", "COMPLETE", "frames/L02_E0.tif")),
        every=3,
    ),
)
def test_a_file_that_is_not_regular_is_reported_and_never_waited_for(
    sgp, rig, plan, tmp_path, name, replaced
):
    out = tmp_path / "session"
    assert capture(sgp, out, "--rig", rig, "--plan", plan(5000.0)).code == 0
    replaced(out / name)
    sheet = ("info", out, "--sheet", tmp_path / "sheet.png")
    export = ("export", out, "--format", "exr", "--out", tmp_path / "exr")
    for words in (("verify", out), sheet, ("compact", out), export):
        answer = sgp("capture", *words)
        assert answer.code == 4, words
        assert name in answer.out + answer.err
        assert re.search("regular file|link that leaves", answer.out + answer.err)
        assert answer.err.count("error:") <= 1
