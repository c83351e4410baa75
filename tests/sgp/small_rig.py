"""A small simulated rig, and commands that record with it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

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
# The same rig for a test in virtual time.
WORLD_RIG = RIG + 'camera = "inside"\nrealtime = false\n'
CAPTURE = [sys.executable, "-c", "from sgp import capture; capture()"]


def capture(sgp, *words, **options):
    """Call ``sgp capture run``, without the checks before the recording unless requested."""
    more = [] if options.pop("check", False) else ["--skip-check"]
    return sgp("capture", "run", *words, *more)


def events(folder):
    return [line.event for line in Session.open(folder).events if line.event != "paused"]


def interrupted(words, file: Path, cwd: Path | None = None) -> str:
    """Start a command, press Ctrl-C when it has written a file, and return what it prints."""
    process = subprocess.Popen(
        [str(word) for word in words],
        cwd=cwd,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"NUMBA_NUM_THREADS": "1"},
    )
    deadline = time.monotonic() + 60
    while not file.exists():
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, message = process.communicate(timeout=60)
    assert process.returncode == 130, message
    assert "Traceback" not in message
    return message


def press_ctrl_c(world, *, before: str) -> None:
    """Send SIGINT to the program that is about to rename a file to this name; in virtual time."""
    on_step = world.scheduler.on_step

    def press(name: str) -> None:
        on_step(name)
        if name == f"rename to {before}":
            world.scheduler.on_step = on_step
            world.scheduler.program.pending.append(signal.SIGINT)

    world.scheduler.on_step = press
