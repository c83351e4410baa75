"""A `capture` command on the simulated rig with an injected fault, as a process of its own.

python benchmarks/capture_struck.py FAULT run|resume FOLDER, started only by capture_faults.py.

FAULT is a key of `PLANTS`, or "none". In addition to the messages for the operator, stderr has a
line with the bench state and one for each frame that is safe; it waits for the end of stdin after
frame `FAULT_AT`.
"""

import os
import sys
import threading
import time
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial
from itertools import count

from capture_bench import PLAN, bench_of, open_planes

BENCH, SHOT = "bench: ", "frame: "
# Number of the frame, command or write at which the fault begins.
FAULT_AT = 14
STALL_S = 1.5


def main(fault, command, folder):
    """Run a command with an injected fault."""
    import acquisition
    import rig
    import sgp.commands.capture as capture
    from sgp.app import _group
    from sgp.app import run as front_door

    PLANTS.get(fault, lambda: None)()
    plan = PLAN.changed(retakes=3) if fault.endswith("retakes") else PLAN

    def opened(_):
        bench = open_planes()
        print(f"{BENCH}{bench_of(bench)}", file=sys.stderr, flush=True)
        return bench

    frames = count(1)

    def on_frame(line):
        print(f"{SHOT}{line.file}", file=sys.stderr, flush=True)
        if next(frames) == FAULT_AT:
            sys.stdin.read()  # until the benchmark has planted its fault

    rig.open_rig = opened
    acquisition.record = reporting(acquisition.record, on_frame)
    acquisition.resume = reporting(acquisition.resume, on_frame)
    capture.chosen_plan = lambda *_: (plan, ())
    sys.exit(front_door(_group("capture"), [command, folder, "--rig", "simulated", "--skip-check"]))


def reporting(function, on_frame):
    """Return a recording function that also reports its frames."""

    def reported(*words, hooks, **more):
        return function(*words, hooks=replace(hooks, on_frame=on_frame), **more)

    return reported


def stall():
    """Make fsync hang from some write on."""
    import acquisition

    real, calls = os.fsync, [0]

    def fsync(descriptor):
        calls[0] += 1
        if calls[0] > 3 * FAULT_AT:
            threading.Event().wait()
        real(descriptor)

    os.fsync = fsync
    acquisition.record = partial(acquisition.record, stall_s=STALL_S)


def unplug():
    """Unplug the camera instead of exposing."""
    import simulator.rigs.bench_rig as simulated

    class Unplugged(simulated.GentlCamera):
        def __init__(self, *words, **more):
            super().__init__(*words, **more)
            self.set_fault(FAULT_AT, "unplug")

    simulated.GentlCamera = Unplugged


def reset():
    """Restart the board in the middle of a command."""
    import simulator.rigs.bench_rig as simulated
    from simulator.led_board import BoardFault

    class Restarting(simulated.VirtualBoard):
        def __init__(self, *words):
            super().__init__(*words)
            self.set_faults(BoardFault(kind="reset", verb="OFF", skip=FAULT_AT + 2))

    simulated.VirtualBoard = Restarting


def jump():
    """Make the system clock wrong by a different number of hours every time it is read."""
    import acquisition.session.writer as session_writer

    calls = [0]

    def now():
        calls[0] += 1
        return datetime.now(UTC) + timedelta(hours=(-1, 24, 0)[calls[0] % 3])

    real = session_writer.SessionWriter.create.__func__
    session_writer.SessionWriter.create = classmethod(
        lambda cls, folder, manifest: real(cls, folder, manifest, clock=now)
    )
    real_time = time.time
    time.time = lambda: real_time() + (-3600, 86400, 0)[calls[0] % 3]


PLANTS = {
    "writer stalled": stall,
    "camera unplugged": unplug,
    "board reset": reset,
    "board reset, retakes": reset,
    "clock jump": jump,
}


if __name__ == "__main__":
    main(*sys.argv[1:])
