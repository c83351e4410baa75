"""A small simulated rig, and commands that record with it."""

import sys

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


def capture(sgp, *words, **options):
    """Call ``sgp capture run``, without the checks before the recording unless requested."""
    more = [] if options.pop("check", False) else ["--skip-check"]
    return sgp("capture", "run", *words, *more)


def events(folder):
    return [line.event for line in Session.open(folder).events if line.event != "paused"]
