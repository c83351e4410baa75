"""A command that receives a signal while it starts or compiles ends with one line."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "signals_at_start.py"
# Sends a signal while a module is being found, in the middle of other imports. An import in the
# signal handler would sometimes make the interrupted one fail.
STRUCK = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_{hangup})
class Strike:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.{name})
        frame = sys._getframe()
        while frame := frame.f_back:
            if frame.f_code.co_name == "_handle":
                print("the handler imports", name, file=sys.stderr)
sys.meta_path.insert(0, Strike())
import sgp
sgp.main()
"""
WORDS = "compare", "absent-a.png", "absent-b.png"


def struck(name: str, module: str, *words: str, hangup: str = "DFL"):
    program = STRUCK.format(name=name, module=module, hangup=hangup)
    command = [sys.executable, "-P", "-c", program, *WORDS, *words]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
@pytest.mark.parametrize(
    "module", ["sgp.app", "cyclopts", "rig", "numpy._core.multiarray", "processing"]
)
def test_a_signal_while_modules_load_ends_with_one_line(name, module):
    done = struck(name, module)
    cause = "Ctrl-C" if name == "SIGINT" else name
    assert done.stderr == f"error: stopped by {cause}\n"
    assert done.returncode == 128 + getattr(signal, name)
    assert done.stdout == ""


def test_the_handler_imports_nothing():
    # `rig` is loaded, and the interrupted import continues after the signal.
    done = struck("SIGTERM", "sgp.results.metrics")
    assert done.stderr in (
        "error: stopped by SIGTERM\n",
        f"error: {WORDS[1]}: no such file or folder\n",
    )


def test_the_line_is_json_with_the_option_json():
    done = struck("SIGTERM", "rig", "--json")
    assert '"error": "stopped by SIGTERM", "exit_code": 143' in done.stdout


def test_an_ignored_hangup_stays_ignored():
    done = struck("SIGHUP", "rig", hangup="IGN")
    assert done.returncode == 2
    assert "absent-a.png" in done.stderr


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_signals_while_numba_compiles_never_crash_a_command():
    command = [sys.executable, str(BENCHMARK), "--signals", "3", "--seed", "5"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
