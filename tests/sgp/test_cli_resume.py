"""``capture resume``: interrupted recordings are completed, after the same checks."""

import json
import shutil
from contextlib import closing

import pytest

from acquisition import Session
from acquisition.session import SessionWriter
from tests.sgp.small_rig import CAPTURE, RIG, WORLD_RIG, capture, events, interrupted


@pytest.mark.slow
def test_an_led_that_dies_is_listed_and_the_rest_completed(sgp, rig, tmp_path, plan):
    out = tmp_path / "s"
    lamps = "[options.lamps]\ndead = [2]\n"
    rig.write_text(WORLD_RIG + lamps, encoding="utf-8")
    planned = plan(5000.0)
    assert capture(sgp, out, "--rig", rig, "--plan", planned).code == 3
    dead = WORLD_RIG.replace("leds = 6", "leds = 6\ndead_leds = [2]")
    rig.write_text(dead + lamps, encoding="utf-8")
    missing = len(Session.open(out).missing)
    answer = sgp("capture", "resume", out, "--rig", rig, "--plan", planned, "--dry-run", "--json")
    assert json.loads(answer.out)["metrics"]["shots"] == missing - 1
    answer = sgp("capture", "resume", out, "--rig", rig, "--plan", planned).ok()
    assert "LED 2 died: 1 shot skipped" in answer.err
    assert sorted(f.led for f in Session.open(out).frames if f.role == "light") == [0, 1, 3, 4, 5]
    answer = sgp("capture", "verify", out).ok()
    assert "1 planned frame was skipped because its LED died: L02_E0.tif" in answer.out
    assert "LED 2 died" in sgp("capture", "info", out).err


def test_resuming_checks_disk_and_rig_first(sgp, rig, with_flats, tmp_path, monkeypatch):
    out = tmp_path / "s"
    assert capture(sgp, out, "--rig", rig, "--plan", with_flats).code == 2
    before = (out / "journal.jsonl").read_bytes()
    usage = shutil.disk_usage(tmp_path)
    with monkeypatch.context() as full:
        full.setattr(shutil, "disk_usage", lambda path: usage._replace(free=1000))
        assert "the check before recording failed: disk: " in sgp(
            "capture", "resume", out, "--rig", rig
        ).error_line(3)
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


def test_ctrl_c_leaves_a_dark_rig_and_an_intact_incomplete_session(sgp, real_rig, plan, tmp_path):
    out = tmp_path / "session"
    options = ["--rig", real_rig, "--plan", plan(200_000.0), "--skip-check"]
    message = interrupted([*CAPTURE, "run", out, *options], out / "frames" / "L01_E0.tif")
    assert "Ctrl-C" in message
    assert "incomplete" in message
    session = Session.open(out)
    assert not session.complete
    assert 0 < len(session.missing) < 7
    assert "the LEDs are off" in message
    assert "stopping after this shot" in message
    assert events(out) == ["camera_settings", "interrupted"]
    assert session.events[-1].details["leds_confirmed_off"] is True
    answer = sgp("capture", "verify", out, "--json")
    assert answer.code == 4
    found = json.loads(answer.out)["metrics"]
    assert found["whole"] is True
    assert found["complete"] is False
    # Another rig is refused; the same rig takes the missing shots.
    other = tmp_path / "other.toml"
    other.write_text(RIG.replace("width = 64", "width = 72"), encoding="utf-8")
    assert "camera width was 64 and is 72" in sgp(
        "capture", "resume", out, "--rig", other
    ).error_line(4)
    assert "plan exposures_us was (200000.0,) and is (100000.0,)" in sgp(
        "capture", "resume", out, "--rig", real_rig, "--plan", plan(100_000.0)
    ).error_line(4)
    before = [frame.line for frame in session.frames]
    answer = sgp("capture", "resume", out, "--rig", real_rig, "--dry-run", "--json")
    assert json.loads(answer.out)["metrics"]["shots"] == len(session.missing)
    assert Session.open(out).events == session.events
    assert sgp("capture", "resume", out, "--rig", real_rig).code == 0
    assert [frame.line for frame in Session.open(out).frames][: len(before)] == before
    assert sgp("capture", "verify", out).code == 0
    journal = (out / "journal.jsonl").read_bytes()
    answer = sgp("capture", "resume", out, "--rig", real_rig).ok()
    assert "already complete: no shot is missing" in answer.err
    assert (out / "journal.jsonl").read_bytes() == journal


@pytest.mark.slow
def test_a_torn_last_line_is_reported_on_resuming_and_its_frame_taken_again(sgp, rig, recorded):
    (recorded / "COMPLETE").unlink()
    # The last line is the comparison of the repeat, the one before it is the repeat.
    *lines, _ = (recorded / "journal.jsonl").read_bytes().splitlines(keepends=True)
    (recorded / "journal.jsonl").write_bytes(b"".join(lines)[:-40])
    answer = sgp("capture", "resume", recorded, "--rig", rig, "--skip-check").ok()
    assert answer.err.count("writing the last line was interrupted") == 1
    assert "missing shots that have been taken: 1" in answer.err
    assert sgp("capture", "verify", recorded).code == 0


@pytest.mark.slow
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
