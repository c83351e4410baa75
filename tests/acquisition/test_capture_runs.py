"""The committed runs that show what a recording withstands, in small: they must not rot."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def run(*words: str) -> str:
    """Run a benchmark and return what it printed; it must end well."""
    ended = subprocess.run(
        [sys.executable, str(BENCHMARKS / words[0]), *words[1:]],
        capture_output=True,
        text=True,
        check=False,
        timeout=200,
        env=os.environ | {"NUMBA_NUM_THREADS": "1"},
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert ended.stdout.endswith("passed\n")
    return ended.stdout


@pytest.mark.skipif(sys.platform == "win32", reason="forks processes")
def test_kills_lose_nothing() -> None:
    told = run("capture_kill.py", "--kills", "6", "--seed", "5")
    assert "lost: 0, accepted with wrong pixels: 0" in told


def test_flips_are_named() -> None:
    assert "90 flips, 0 not detected" in run("capture_flips.py", "--flips", "90")


@pytest.mark.skipif(sys.platform == "win32", reason="runs the virtual board on a pty")
@pytest.mark.parametrize("fault", ["writer stalled", "board reset", "clock jump"])
def test_faults_end_dark_and_resumable(fault: str) -> None:
    assert f"{fault}: exit code" in run("capture_faults.py", "--only", fault)


def _may_mount() -> bool:
    try:
        return not subprocess.run(
            ["unshare", "-rm", "true"], capture_output=True, check=False
        ).returncode
    except OSError:
        return False


@pytest.mark.skipif(not _may_mount(), reason="this system allows no user namespace (unshare -rm)")
@pytest.mark.parametrize("fault", ["disk full", "disk read-only"])
def test_a_disk_that_fails_ends_dark_and_resumable(fault: str) -> None:
    assert f"{fault}: exit code 3" in run("capture_faults.py", "--only", fault)
