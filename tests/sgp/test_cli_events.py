"""``--events``: a line of JSON per event, with the keys that docs/commands.md lists."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path
from typing import Any

import pytest

from acquisition import Session
from sgp.sessions import Acceptance, CaptureTalk, EventStream, ResumeCommand
from sgp.sessions.event_stream import VERSION
from tests.sgp.small_rig import CAPTURE
from tests.sgp.test_cli_accept import plan_file, rig_file

ROOT = Path(__file__).parents[2]


def documented() -> dict[str, list[str]]:
    """Return the keys of each event that the document lists."""
    text = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    table = text.partition("## Events of a recording")[2].partition("\n## ")[0]
    rows = re.findall(r"^- (`.*?): (.*)$", table, re.MULTILINE)
    return {
        event: re.findall(r"`(\w+)`", keys)
        for events, keys in rows
        for event in re.findall(r"`(\w+)`", events)
    }


def stream(text: str) -> list[dict[str, Any]]:
    """Return the events of a stream after checking them against the document."""
    found = [json.loads(line) for line in text.splitlines()]
    keys = documented()
    for event in found:
        assert list(event) == ["version", "event", *keys[event["event"]]]
        assert event["version"] == VERSION
    return found


def kinds(found: list[dict[str, Any]]) -> list[str]:
    return list(dict.fromkeys(event["event"] for event in found))


def test_the_events_of_version_1():
    assert VERSION == 1
    assert documented() == {
        "started": ["session", "rig", "plan", "shots"],
        "progress": ["stage", "done", "total"],
        "frame": [
            "file", "role", "led", "bracket", "repeat", "exposure_us", "clipped_fraction", "done",
            "total", "seconds_left",
        ],
        "journal": ["name", "details"],
        "notice": ["code", "text", "where", "severity"],
        "question": ["code", "text", "where", "severity"],
        "finished": ["session", "verdict", "text", "exit_code"],
        "failed": ["error", "exit_code"],
    }  # fmt: skip


@pytest.mark.usefixtures("simulated_world")
def test_a_recording_states_every_frame_and_every_event(sgp, tmp_path):
    out, plan = tmp_path / "s", plan_file(tmp_path, 3000.0)
    answer = sgp(
        "capture", "run", out, "--rig", rig_file(tmp_path), "--plan", plan, "--events"
    ).ok()
    found = stream(answer.out)
    assert kinds(found) == ["progress", "notice", "started", "journal", "frame", "finished"]
    session = Session.open(out)
    frames = [event for event in found if event["event"] == "frame"]
    assert [one["file"] for one in frames] == [Path(f.line.file).name for f in session.frames]
    assert [one["done"] for one in frames] == list(range(1, 9))
    assert [one["seconds_left"] is None for one in frames] == [True, *[False] * 7]
    assert frames[-1]["seconds_left"] == 0
    (started,) = (event for event in found if event["event"] == "started")
    assert started["shots"] == [one["file"] for one in frames]
    journal = [(one["name"], one["details"]) for one in found if one["event"] == "journal"]
    assert journal == [(line.event, line.details) for line in session.events]
    assert "compared" in dict(journal)
    end = found[-1]
    assert (end["session"], end["verdict"], end["exit_code"]) == (str(out), "good", 0)
    (notice,) = (one for one in found if one["event"] == "notice")
    assert notice["code"] == "check-exposure"
    assert f"warning: exposure: {notice['text']}" in answer.err


@pytest.mark.usefixtures("simulated_world")
def test_a_question_is_stated_and_answered_by_accept(sgp, tmp_path):
    words = ("--rig", rig_file(tmp_path), "--plan", plan_file(tmp_path, 900_000.0), "--events")
    refused = sgp("capture", "run", tmp_path / "s", *words)
    assert refused.code == 3
    *_, question, failed = stream(refused.out)
    assert (question["event"], question["code"]) == ("question", "exposure-saturated")
    assert (failed["event"], failed["exit_code"]) == ("failed", 3)
    assert failed["error"].endswith("; --accept exposure-saturated continues anyway")
    accepted = sgp("capture", "run", tmp_path / "s", *words, "--accept", "exposure-saturated").ok()
    assert "question" not in kinds(stream(accepted.out))


@pytest.mark.usefixtures("simulated_world")
def test_a_failure_and_the_resume_after_it(sgp, tmp_path):
    rig = rig_file(tmp_path)
    rig.write_text(rig.read_text() + "lamps = {dead = [4]}\n")
    words = ("--rig", rig, "--plan", plan_file(tmp_path, 8000.0), "--skip-check", "--events")
    answer = sgp("capture", "run", tmp_path / "s", *words)
    assert answer.code == 3
    *_, failed = stream(answer.out)
    assert "LED 4 gave no light" in failed["error"]
    missing = [shot.file for shot in Session.open(tmp_path / "s").missing if shot.led != 4]
    rig.write_text(rig.read_text().replace("leds = 6", "leds = 6\ndead_leds = [4]"))
    resume = ("capture", "resume", tmp_path / "s", "--rig", rig, "--skip-check", "--events")
    found = stream(sgp(*resume).ok().out)
    (started,) = (event for event in found if event["event"] == "started")
    assert started["shots"] == missing
    assert (found[-1]["event"], found[-1]["verdict"]) == ("finished", "check")
    assert kinds(stream(sgp(*resume).ok().out)) == ["notice", "finished"]


def test_damage_is_a_notice(capsys, tmp_path):
    talk = CaptureTalk(ResumeCommand(tmp_path), accepting=Acceptance(audience=EventStream()))
    talk.on_damage("L00_E0.tif: damaged")
    (notice,) = stream(capsys.readouterr().out)
    assert (notice["code"], notice["severity"]) == ("frame-damaged", "error")


@pytest.mark.usefixtures("simulated_world")
def test_the_white_card_is_not_asked_for(sgp, tmp_path, monkeypatch):
    monkeypatch.setattr("sgp.sessions.audience._is_attended", lambda: True)
    words = ("--rig", rig_file(tmp_path), "--plan", plan_file(tmp_path, 8000.0, "flats = 1\n"))
    answer = sgp("capture", "run", tmp_path / "s", *words, "--skip-check", "--events")
    *_, failed = stream(answer.out)
    assert (failed["event"], failed["exit_code"]) == ("failed", 2)
    assert "put the white card under the camera" in failed["error"]


def test_lines_and_one_object_exclude_each_other(sgp, tmp_path):
    answer = sgp(
        "capture", "run", tmp_path / "s", "--rig", rig_file(tmp_path), "--events", "--json"
    )
    assert answer.code == 2
    assert answer.err == ("error: --events prints lines and --json one object: give one of them\n")
    assert json.loads(answer.out)["exit_code"] == 2


@pytest.mark.parametrize("lines", [0, 3])
def test_a_reader_that_exits_does_not_end_the_recording(tmp_path, lines):
    words = ("--rig", rig_file(tmp_path), "--plan", plan_file(tmp_path, 8000.0), "--skip-check")
    command = [str(word) for word in (*CAPTURE, "run", tmp_path / "s", *words, "--events")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        for _ in range(lines):
            process.stdout.readline()
        process.stdout.close()
        assert process.stderr is not None
        message = process.stderr.read()
        assert process.wait() == 0, message
    assert Session.open(tmp_path / "s").complete
    assert b"Error" not in message
