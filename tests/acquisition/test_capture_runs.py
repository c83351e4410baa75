"""Short runs of the fault benchmarks, so that these keep working."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cases import cases

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def ended_run(*words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a benchmark to its end."""
    return subprocess.run(
        [sys.executable, str(BENCHMARKS / words[0]), *words[1:]],
        capture_output=True,
        text=True,
        check=False,
        timeout=200,
        env=os.environ | environment,
    )


def run(*words: str) -> str:
    """Run a benchmark and return its output; it must succeed."""
    ended = ended_run(*words, NUMBA_NUM_THREADS="1")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert ended.stdout.endswith("passed\n")
    return ended.stdout


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="forks processes")
def test_kills_lose_nothing() -> None:
    output = run("capture_kill.py", "--kills", "6", "--seed", "5")
    assert "lost: 0, accepted with wrong pixels: 0" in output


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="runs the virtual board on a pty")
@pytest.mark.parametrize("more", [(), ("--buffers", "3", "--lose", "0.1")], ids=["all", "lossy"])
def test_no_sequence_ends_on_a_busy_host(more: tuple[str, ...]) -> None:
    small = ("--sequences", "3", "--lights", "9", "--rate", "100", "--size", "32x24", "--busy", "2")
    output = run("sequence_stress.py", *small, *more)
    assert re.search(r"recordings ended +0\n  frames kept +33\n", output)
    assert re.search(r"frames under a wrong LED +0\n", output)
    assert bool(re.search(r"taken again +[1-9]", output)) == bool(more)


@pytest.mark.slow
def test_flips_are_detected() -> None:
    assert "90 flips, 0 not detected" in run("capture_flips.py", "--flips", "90")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="runs the virtual board on a pty")
@pytest.mark.parametrize(
    "fault",
    [
        "writer stalled",
        "camera unplugged",
        "board reset",
        "board reset, retakes",
        "clock jump",
    ],
)
def test_recordings_with_faults_end_dark_and_can_be_resumed(fault: str) -> None:
    assert f"{fault}: exit code" in run("capture_faults.py", "--only", fault)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="runs the virtual board on a pty")
@cases(
    ("words", "code", "said"),
    {
        "few": (("soak.py", "--flashes", "0", "--cycles", "5"), 0, "5 times opened"),
        "too much memory": (
            ("soak.py", "--flashes", "0", "--cycles", "5", "--growth-mib", "-9999"),
            1,
            "MiB more than after a tenth",
        ),
        "all frames lost": (
            (
                "sequence_stress.py",
                "--sequences",
                "1",
                "--lights",
                "4",
                "--size",
                "32x24",
                "--lose",
                "1",
            ),
            1,
            "recordings ended                1",
        ),
        "too slow": (
            ("rig_pass.py", "--lights", "4", "--size", "64x48", "--rate", "2000"),
            1,
            "software takes more than 1.5 times the camera's time",
        ),
    },
)
def test_a_run_that_misses_its_limit_fails(words: tuple[str, ...], code: int, said: str) -> None:
    ended = ended_run(*words)
    assert ended.returncode == code, ended.stdout + ended.stderr
    assert said in ended.stdout
    assert "Traceback" not in ended.stderr


def _may_mount() -> bool:
    try:
        return not subprocess.run(
            ["unshare", "-rm", "true"], capture_output=True, check=False
        ).returncode
    except OSError:
        return False


@pytest.mark.slow
@pytest.mark.skipif(not _may_mount(), reason="user namespaces are not allowed (unshare -rm)")
@pytest.mark.parametrize(
    "fault",
    [
        "disk full",
        "disk read-only at first",
        "disk read-only in the middle",
        "disk read-only on resuming",
    ],
)
def test_recordings_on_a_failing_disk_end_dark_and_can_be_resumed(fault: str) -> None:
    assert f"{fault}: exit code 3" in run("capture_faults.py", "--only", fault)


@pytest.mark.skipif(sys.platform == "win32", reason="runs the virtual board on a pty")
def test_light_is_judged_by_the_error_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Notes may appear while the recording runs; the LEDs must be off at the error line."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    import capture_faults

    state = tmp_path / "bench.state"
    talk = tmp_path / "talk.py"
    talk.write_text(
        "import sys, time\n"
        f"print({f'{capture_faults.BENCH}{state}'!r}, file=sys.stderr)\n"
        "print('the disk is slower than the camera', file=sys.stderr, flush=True)\n"
        "time.sleep(0.1)\n"
        f"open({str(state)!r}, 'w').write(str(time.monotonic_ns()))\n"
        "print('error: the camera is gone', file=sys.stderr)\n"
        "sys.exit(3)\n",
        encoding="utf-8",
    )

    class State:
        def close(self) -> None: ...

    monkeypatch.setattr(capture_faults, "STRUCK", talk)
    monkeypatch.setattr(capture_faults, "open_state", lambda path: State())
    monkeypatch.setattr(capture_faults, "last_light_ns", lambda *_: int(state.read_text()))
    code, line, dark_s, unclear = capture_faults.run("none", "run", tmp_path)
    assert (code, line, unclear) == (3, "error: the camera is gone", [])
    assert dark_s > 0
