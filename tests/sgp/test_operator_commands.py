"""What operators read: findings as lists, commands that can be pasted, resuming without changes."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from acquisition import Session
from acquisition.preflights import Check, Preflight
from rig import RigError
from sgp.sessions import Acceptance, Preparation, ResumeCommand, take_findings
from tests.sgp.small_rig import RIG, WORLD_RIG, interrupted


@pytest.fixture
def bench(tmp_path):
    """A folder with a rig file and a plan, whose names need quotes."""
    folder = tmp_path / "Ada's rigs & plans"
    folder.mkdir()
    (folder / "my rig.toml").write_text(RIG)
    (folder / "plan.toml").write_text("leds = [0, 1, 2, 3, 4, 5]\nexposures_us = [200000]\n")
    return folder


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="requires SIGINT and a POSIX shell")
def test_the_command_printed_after_ctrl_c_works_when_pasted(bench, sgp):
    program = [sys.executable, "-P", "-m", "sgp", "capture", "run", "owl 1", "--skip-check"]
    words = [*program, "--rig", "my rig.toml", "--plan", "plan.toml"]
    message = interrupted(words, bench / "owl 1" / "frames" / "L01_E0.tif", bench)
    command = re.search("`(.*)` takes the missing frames", message)[1]
    assert shlex.split(command)[3:] == [
        *("capture", "resume", "owl 1", "--rig", "my rig.toml", "--skip-check")
    ]
    done = subprocess.run(["sh", "-c", command], cwd=bench, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert Session.open(bench / "owl 1").complete


@pytest.mark.parametrize(
    ("started", "on_path", "expected"),
    [
        pytest.param("/opt/sgp/bin/capture", True, ["capture"], id="capture"),
        pytest.param("/opt/sgp/bin/sgp", True, ["capture"], id="sgp"),
        pytest.param("venv/bin/sgp", False, ["venv/bin/sgp", "capture"], id="sgp by its path"),
        pytest.param("venv/bin/capture", False, ["venv/bin/capture"], id="capture by its path"),
        pytest.param("/lib/sgp/__main__.py", False, [sys.executable, "-m", "sgp", "capture"]),
        pytest.param("/usr/bin/pytest", False, ["capture"], id="another program"),
        pytest.param("/lib/pytest/__main__.py", False, ["capture"], id="another module"),
    ],
)
def test_the_command_starts_the_same_program(monkeypatch, started, on_path, expected):
    monkeypatch.setattr(sys, "argv", [started])
    monkeypatch.setattr("shutil.which", lambda name: started if on_path else None)
    monkeypatch.setattr("os.path.samefile", lambda one, other: one == str(other))
    words = shlex.split(ResumeCommand(Path("a b"), "bench").text(retake_damaged=True))
    assert words == [*expected, "resume", "a b", "--rig", "bench", "--retake-damaged"]


def state(folder):
    """Return the contents and times of everything in a folder."""
    return {
        path: (path.stat().st_mtime_ns, path.read_bytes() if path.is_file() else None)
        for path in (folder, *folder.rglob("*"))
    }


@pytest.mark.usefixtures("simulated_world")
def test_resuming_a_complete_session_changes_nothing(bench, sgp):
    rig, plan, out = bench / "my rig.toml", bench / "plan.toml", bench / "owl 1"
    rig.write_text(WORLD_RIG)
    words = ("capture", "run", out, "--rig", rig, "--plan", plan, "--skip-check")
    assert sgp(*words).code == 0
    before = state(bench)
    for more in ((), ("--plan", plan), ("--dry-run",), ("--skip-check",), ("--retake-damaged",)):
        answer = sgp("capture", "resume", out, "--rig", rig, *more).ok()
        assert "already complete" in answer.err
        assert "session   " in answer.out
        assert state(bench) == before
    other = bench.parent / "other.toml"
    other.write_text("leds = [0, 1]\nexposures_us = [200000]\n")
    answer = sgp("capture", "resume", out, "--rig", rig, "--plan", other)
    assert "is complete, and was recorded with another plan" in answer.error_line(4)
    assert state(bench) == before


FOUND = (
    Check("disk", "failed", "1 MB free, 3 MB required: free space"),
    Check("focus", "warning", "detail 0.01: focus the lens"),
    Check("LEDs", "failed", "a; b", {}, ("LED 2 gives no light: check it", "LED 4: clean it")),
)


def test_several_findings_are_a_list(capsys):
    with pytest.raises(RigError, match="failed: see the 3 findings above") as failed:
        take_findings(Preflight(FOUND), Preparation(), Acceptance())
    assert failed.value.findings[2] == "LEDs: LED 4: clean it"
    assert capsys.readouterr().err.splitlines() == [
        "- disk: 1 MB free, 3 MB required: free space",
        "- LEDs: LED 2 gives no light: check it",
        "- LEDs: LED 4: clean it",
    ]


def test_one_finding_is_the_error_itself(capsys):
    with pytest.raises(RigError, match="failed: disk: 1 MB free, 3 MB required: free space"):
        take_findings(Preflight(FOUND[:2]), Preparation(), Acceptance())
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("simulated_world")
def test_the_check_prints_one_line_for_each_finding(sgp, bench):
    rig = bench / "dead.toml"
    rig.write_text(WORLD_RIG + "lamps = {dead = [2, 4]}\n")
    answer = sgp("capture", "check", bench / "new", "--rig", rig)
    assert answer.code == 3
    found = [line for line in answer.out.splitlines() if "gives no light" in line]
    assert [line[:21].split() for line in found] == [["failed", "LEDs"], []]
    assert ["LED 2" in found[0], "LED 4" in found[1]] == [True, True]
    assert all("check its plug" in line for line in found)
