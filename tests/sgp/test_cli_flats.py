"""Flats wait until the white card is under the camera."""

import os
import signal
import subprocess
import sys
import time

import pytest

from acquisition import Session
from tests.cases import cases
from tests.sgp.small_rig import CAPTURE, capture


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
            _, message = process.communicate(timeout=100)
        finally:
            process.kill()
            os.close(mine)
            os.close(its)
    return process.returncode, message


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="requires a pty for the prompt")
def test_one_ctrl_c_ends_the_wait_for_the_card(sgp, real_rig, with_flats, tmp_path):
    out = tmp_path / "s"
    code, message = at_the_prompt(
        real_rig, with_flats, out, lambda process, _: process.send_signal(signal.SIGINT)
    )
    assert code == 130, message
    assert "stopping after this shot" in message
    assert "the LEDs are off" in message
    assert [shot.role for shot in Session.open(out).missing] == ["flat"] * 3
    assert sgp("capture", "resume", out, "--rig", real_rig).code == 0


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="requires a pty for the prompt")
def test_enter_takes_the_flats(real_rig, with_flats, tmp_path):
    out = tmp_path / "s"

    def press(process, terminal):
        assert not any(frame.role == "flat" for frame in Session.open(out).recorded)
        os.write(terminal, b"\n")

    code, message = at_the_prompt(real_rig, with_flats, out, press)
    assert code == 0, message
    assert Session.open(out).complete


def leave_it(process, terminal):
    time.sleep(1)  # enough time for three flats of 5 ms
    process.send_signal(signal.SIGINT)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="requires a pty for the prompt")
@cases(
    ("typed_before", "act", "code"),
    {
        "Enter": (b"\n\n", leave_it, 130),
        "Ctrl-D": pytest.param(
            b"", lambda _, terminal: os.write(terminal, b"\x04"), 2, marks=pytest.mark.slow
        ),
    },
)
def test_only_enter_at_the_prompt_takes_the_flats(
    real_rig, with_flats, tmp_path, typed_before, act, code
):
    """Neither an Enter before the prompt nor the end of the input counts."""
    out = tmp_path / "s"
    ended, message = at_the_prompt(real_rig, with_flats, out, act, typed_before)
    assert ended == code, message
    assert [shot.role for shot in Session.open(out).missing] == ["flat"] * 3
