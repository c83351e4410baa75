"""Findings that make a recording useless need `--accept` or an answer; others stop nothing."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from acquisition import Session
from sgp.sessions import audience
from simulator.camera.virtual_sensor import VirtualSensor
from tests.cases import cases
from tests.sgp.small_rig import capture, events, press_ctrl_c

pytestmark = pytest.mark.usefixtures("simulated_world")

RIG = """
name = "desk"
driver = "simulated"
leds = 6
[options]
scene = "{scene}"
width = 160
height = 128
seed = 3
camera = "inside"
realtime = false
"""


def rig_file(folder: Path, scene: str | Path = "coin", *, more: str = "") -> Path:
    path = folder / "rig.toml"
    path.write_text(RIG.format(scene=scene) + more, encoding="utf-8")
    return path


def plan_file(folder: Path, exposure_us: float, more: str = "") -> Path:
    path = folder / "plan.toml"
    path.write_text(f'leds = "0-5"\nexposures_us = [{exposure_us}]\n{more}', encoding="utf-8")
    return path


FINDINGS = {
    "saturated": (900_000.0, "", "exposure-saturated", "saturated: shorten the exposure"),
    "too dark": (300.0, "", "exposure-too-dark", "of full scale"),
}


@cases(("exposure_us", "more", "code", "says"), FINDINGS)
def test_a_useless_recording_needs_accept(sgp, tmp_path, exposure_us, more, code, says):
    words = ("--rig", rig_file(tmp_path), "--plan", plan_file(tmp_path, exposure_us, more))
    done = sgp("capture", "run", tmp_path / "s", *words)
    assert done.code == 3
    line = done.err.splitlines()[-1]
    assert says in line
    assert line.endswith(f"; --accept {code} continues anyway")
    assert not (tmp_path / "s").exists()
    checked = sgp("capture", "check", tmp_path / "s", *words, "--quick", "--json")
    assert checked.code == 3
    assert json.loads(checked.out)["metrics"]["doubts"] == [code]
    ready = sgp("capture", "check", tmp_path / "s", *words, "--quick", "--accept", code)
    assert ready.ok().out.splitlines()[-1] == "ready to record"
    sgp("capture", "run", tmp_path / "s", *words, "--accept", code).ok()
    session = Session.open(tmp_path / "s")
    assert session.complete
    (event,) = (line for line in session.events if line.event == "checked")
    assert event.details["accepted"] == [code]


@pytest.mark.slow
def test_several_codes_are_accepted_and_others_refused(sgp, tmp_path):
    words = ("--rig", rig_file(tmp_path), "--plan", plan_file(tmp_path, 900_000.0))
    both = ("--accept", "object-changed", "--accept", "exposure-saturated")
    assert sgp("capture", "check", tmp_path / "s", *words, "--quick", *both).code == 0
    one = ("--accept", "object-changed")
    assert sgp("capture", "check", tmp_path / "s", *words, "--quick", *one).code == 3
    line = sgp("capture", "run", tmp_path / "s", *words, "--accept", "room").error_line(2)
    assert "exposure-saturated" in line


@cases(("answer", "code"), {"yes": ("yes\n", 0), "y": ("y\n", 0), "no": ("n\n", 3), "end": ("", 3)})
def test_on_a_terminal_the_command_asks(sgp, tmp_path, monkeypatch, answer, code):
    monkeypatch.setattr(audience, "_is_attended", lambda: True)
    monkeypatch.setattr(audience, "_forget_keys", lambda: None)
    monkeypatch.setattr(sys, "stdin", io.StringIO(answer))
    words = ("--rig", rig_file(tmp_path), "--plan", plan_file(tmp_path, 900_000.0))
    done = sgp("capture", "run", tmp_path / "s", *words)
    assert done.code == code
    assert "continue anyway? type yes and press Enter" in done.err
    assert (tmp_path / "s").exists() is (code == 0)


def test_other_warnings_stop_nothing_and_are_printed_once(sgp, tmp_path):
    """Unattended: the exposure is dim, and the object has no fine structure."""
    words = ("--rig", rig_file(tmp_path), "--plan", plan_file(tmp_path, 3000.0))
    done = sgp("capture", "run", tmp_path / "s", *words).ok()
    notes = [line for line in done.err.splitlines() if line.startswith(("note: ", "warning: "))]
    assert any("lengthen the exposure" in line for line in notes)
    assert len(notes) == len(set(notes))
    # Another command states its own notices.
    assert "lengthen the exposure" in sgp("capture", "run", tmp_path / "t", *words).ok().err


def test_the_plan_states_the_repeat(sgp, tmp_path):
    words = ("--rig", rig_file(tmp_path), "--json")
    counts, seconds = {}, {}
    plans = {"with": "", "without": "repeat = false\n", "more": "repeat_every = 2\n"}
    for name, more in plans.items():
        figures = sgp("capture", "plan", plan_file(tmp_path, 8000.0, more), *words).figures()
        counts[name], seconds[name] = figures["counts"], figures["seconds"]
        assert len(figures["shots"]) == sum(figures["counts"].values())
    assert counts["with"] == {"light": 6, "dark": 1, "ambient": 0, "repeat": 1, "flat": 0}
    assert counts["without"]["repeat"] == 0
    assert counts["more"]["repeat"] == 3
    assert seconds["with"] - seconds["without"] == pytest.approx(0.008 + 0.072)
    assert seconds["more"] - seconds["with"] == pytest.approx(2 * (0.008 + 0.072))


OBJECT = """
[object]
kind = "leather"
radius_mm = 90
seed = {seed}
[lights]
kind = "ring"
count = 6
elevation_deg = 45
"""


def test_a_session_is_not_resumed_with_another_object(sgp, world, tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text(OBJECT.format(seed=1), encoding="utf-8")
    rig, out = rig_file(tmp_path, scene), tmp_path / "s"
    press_ctrl_c(world, before="L02_E0.tif")
    words = ("--rig", rig, "--plan", plan_file(tmp_path, 20_000.0))
    assert capture(sgp, out, *words).code == 130
    before = (out / "journal.jsonl").read_bytes()
    missing = len(Session.open(out).missing)
    scene.write_text(OBJECT.format(seed=2), encoding="utf-8")
    resume = ("capture", "resume", out, "--rig", rig, "--skip-check")
    done = sgp(*resume)
    assert done.code == 3
    line = done.err.splitlines()[-1]
    assert "of the image does not fit" in line
    assert "another object, or a part of it or the LED moved; put it back, or record again" in line
    assert line.endswith("; --accept object-changed continues anyway")
    assert (out / "journal.jsonl").read_bytes() == before
    # Another code does not help; the right object does.
    assert sgp(*resume, "--accept", "frame-shifted").code == 3
    assert len(Session.open(out).missing) == missing
    scene.write_text(OBJECT.format(seed=1), encoding="utf-8")
    done = sgp(*resume).ok()
    assert "does not fit" not in done.err
    assert events(out).count("compared") == 2
    assert sgp("capture", "verify", out).ok()


def test_another_object_can_be_accepted(sgp, world, tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text(OBJECT.format(seed=1), encoding="utf-8")
    rig, out = rig_file(tmp_path, scene), tmp_path / "s"
    press_ctrl_c(world, before="L02_E0.tif")
    words = ("--rig", rig, "--plan", plan_file(tmp_path, 20_000.0))
    assert capture(sgp, out, *words).code == 130
    scene.write_text(OBJECT.format(seed=2), encoding="utf-8")
    resume = ("capture", "resume", out, "--rig", rig, "--skip-check")
    done = sgp(*resume, "--accept", "object-changed").ok()
    notes = [line for line in done.err.splitlines() if "does not fit" in line]
    assert len(notes) == 2
    assert "R_L00_E0.tif: " in notes[1]
    found = Session.open(out).events
    first = next(line for line in found if line.event == "compared")
    assert first.details["accepted"] == ["object-changed"]


def moving(monkeypatch, px, change_at):
    """Let the camera of simulated rigs see its scene moved from some lit exposure on."""
    real, lit = VirtualSensor._lit, []

    def moved(self, exposure, end_ns, key):
        planes = real(self, exposure, end_ns, key)
        lit.append(len(planes) > 1)
        if sum(lit) < change_at:
            return planes
        return [(np.roll(plane, px, 1), us) for plane, us in planes]

    monkeypatch.setattr(VirtualSensor, "_lit", moved)


WATCHED = "repeats = 4\nrepeat_every = 4\n"


@cases(("answer", "code"), {"accepted": ("yes\n", 0), "refused": ("no\n", 3)})
def test_a_moved_object_is_asked_about_once(sgp, tmp_path, monkeypatch, answer, code):
    monkeypatch.setattr(audience, "_is_attended", lambda: True)
    monkeypatch.setattr(audience, "_forget_keys", lambda: None)
    monkeypatch.setattr(sys, "stdin", io.StringIO(answer))
    moving(monkeypatch, 2, 6)
    words = ("--rig", rig_file(tmp_path), "--plan", plan_file(tmp_path, 8000.0, WATCHED))
    done = sgp("capture", "run", tmp_path / "s", *words, "--skip-check")
    assert done.code == code
    assert done.err.count("continue anyway?") == 1
    assert "the camera or the object moved by" in done.err
    session = Session.open(tmp_path / "s")
    assert session.complete is (code == 0)
    accepted = [line.details["code"] for line in session.events if line.event == "accepted"]
    assert accepted == ["frame-shifted"] * (code == 0)


def test_an_unattended_recording_stops_for_what_makes_it_useless(sgp, tmp_path, monkeypatch):
    moving(monkeypatch, 2, 6)
    words = ("--rig", rig_file(tmp_path), "--plan", plan_file(tmp_path, 8000.0, WATCHED))
    done = sgp("capture", "run", tmp_path / "s", *words, "--skip-check")
    assert done.code == 3
    *_, state, error = done.err.splitlines()
    assert "capture resume" in state
    assert error.endswith("; --accept frame-shifted continues anyway")
    accepted = ("--skip-check", "--accept", "frame-shifted")
    assert sgp("capture", "run", tmp_path / "t", *words, *accepted).code == 0


def test_an_unattended_recording_names_a_drift_at_once_and_continues(sgp, tmp_path):
    rig = rig_file(tmp_path)
    rig.write_text(rig.read_text() + "lamps = {warm_up = 0.1, warm_up_s = 0.2}\n")
    words = ("--rig", rig, "--plan", plan_file(tmp_path, 8000.0, WATCHED), "--skip-check")
    done = sgp("capture", "run", tmp_path / "s", *words, "--events").ok()
    found = [json.loads(line) for line in done.out.splitlines()]
    notices = [one for one in found if one["event"] == "notice"]
    assert {one["code"] for one in notices} == {"light-changed"}
    assert found.index(notices[0]) < max(
        number for number, one in enumerate(found) if one.get("role") == "light"
    )
    assert [one["text"] for one in notices] == [
        notice.text for notice in Session.open(tmp_path / "s").warnings
    ]
