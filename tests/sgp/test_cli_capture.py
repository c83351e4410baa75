"""Recording on the simulated rig as an operator does: to the end, interrupted, damaged later."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from acquisition import Session

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


def test_a_session_is_recorded_verified_and_told(sgp, rig, plan, tmp_path):
    out = tmp_path / "session"
    words = ("capture", "run", out, "--rig", rig, "--plan", plan(5000.0), "--object-name", "coin")
    assert sgp(*words).code == 0
    assert sgp("capture", "verify", out).code == 0
    told = sgp("capture", "info", out).out
    assert "coin" in told
    assert "L05_E0.tif" in told
    assert sgp(*words).code == 2, "a session is never recorded over"
    assert sgp("capture", "verify", out).code == 0


def test_verify_names_the_frame_that_one_bit_changed(sgp, rig, plan, tmp_path):
    out = tmp_path / "session"
    assert sgp("capture", "run", out, "--rig", rig, "--plan", plan(5000.0)).code == 0
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
        [*CAPTURE, "run", str(out), "--rig", str(rig), "--plan", str(plan(200_000.0))],
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
    # An interruption inside a journal line leaves no room for the event; the line is torn then.
    for event in session.events:
        assert event.event == "interrupted"
        assert event.details["leds_confirmed_off"] is True
    answer = sgp("capture", "verify", out, "--json")
    assert answer.code == 4
    found = json.loads(answer.out)["metrics"]
    assert found["whole"] is True
    assert found["complete"] is False


def test_a_plan_is_shown_without_hardware(sgp, plan):
    answer = sgp("capture", "plan", plan(5000.0), "--width", 100, "--height", 50, "--json")
    metrics = json.loads(answer.out)["metrics"]
    assert metrics["shots"][0] == "D_5000us.tif"
    assert metrics["shots"][1:] == [f"L0{i}_E0.tif" for i in range(6)]
    assert metrics["bytes"] == 7 * 100 * 50 * 2
    assert sgp("capture", "plan", plan(-1.0)).code == 4


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
