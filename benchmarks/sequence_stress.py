"""Record in sequences on a busy host: check that no recording ends and that no LED is mixed up.

The bench's code records on a virtual board and a virtual GenICam camera, one session per recording,
with hashes, flushes and journal as usual, while other processes compute all the time. The pixels of
a frame encode its LED. `--buffers` limits the buffers of the GenTL producer, as some producers do.
`--lose` loses the given share of the frames in transit, which a busy host alone no longer does.

Exit code 1 if a recording ended early, a frame is recorded under another LED than it shows, a
session is damaged or incomplete, or an LED stayed on.
"""

import shutil
import sys
import tempfile
import time
from pathlib import Path
from random import Random

import numpy as np
from capture_bench import dark_in_time, fast_bench, fast_options
from harness import busy, busy_option, command_line

from acquisition import (
    CapturePlan,
    Labels,
    RecordingHooks,
    Session,
    record,
    verify_session,
)
from rig import Board, Rig, RigConfig, RigError
from rig.genicam import open_genicam
from simulator.bench import BenchState

BLACK_DN = 100


def frames(width, height):
    """Return a function whose pixels encode the LED: 100 grey values, plus 50 per LED number."""

    def frame(led):
        above = 0 if led is None else 50 * (led + 1)
        return np.full((height, width), BLACK_DN + above, np.uint16)

    return frame


def led_seen(pixels):
    """Return the LED that the pixels show, None for darkness, or a text if they show neither."""
    code, rest = divmod(int(pixels[0, 0]) - BLACK_DN, 50)
    if rest or not (pixels == pixels[0, 0]).all():
        return "no single LED"
    return code - 1 if code else None


class Tally:
    def __init__(self):
        self.ended = self.frames = self.wrong = self.damaged = self.left_on = 0
        self.lost = self.retaken = self.pauses = 0
        self.problems = []

    def heard(self, event, details):
        self.lost += event == "frames_lost"
        self.retaken += event == "retake"
        self.pauses += event == "paused"

    def session(self, folder):
        """Check the session of a recording."""
        report = verify_session(folder)
        if not (report.ok and report.complete and not report.missing):
            self.damaged += 1
            self.problems += [f"{folder.name}: {problem}" for problem in report.problems]
        for frame in Session.open(folder).frames:
            self.frames += 1
            seen = led_seen(frame.read())
            if seen != frame.led:
                self.wrong += 1
                self.problems.append(f"{frame.path.name}: recorded as {frame.led}, shows {seen}")


def stress(options, out):
    width, height = map(int, options.size.split("x"))
    plan = CapturePlan(leds=tuple(range(options.lights)), exposures_us=(options.exposure_us,),
                       sequence=True)  # fmt: skip
    config = RigConfig(name="stress", driver="bench", leds=options.lights, trigger="board")
    more = {} if options.buffers is None else {"most_buffers": options.buffers}
    dice, tally = Random(options.seed), Tally()
    with (
        fast_bench(options, frames(width, height), **more) as (virtual, camera),
        BenchState(virtual.bench_state_path) as state,
    ):
        rig = None
        for number in range(options.sequences):
            folder = out / f"s{number}"
            if rig is None:
                device = open_genicam(camera.cti, pixel_format="Mono16")
                rig = Rig(Board(virtual.port), device, config)
            first = camera.counts().exposures
            for at in range(len(plan.shots())):
                if dice.random() < options.lose:
                    camera.set_fault(first + at, "lost")
            try:
                record(rig, plan, folder, Labels(), hooks=RecordingHooks(on_event=tally.heard))
            except RigError as error:
                tally.ended += 1
                tally.problems.append(f"recording {number} ended: {error}")
                rig.close()
                rig = None
            else:
                tally.session(folder)
            tally.left_on += not dark_in_time(state)
            shutil.rmtree(folder, ignore_errors=True)
            if number % 20 == 19:
                print(f"{number + 1} recordings ...", flush=True)
        if rig is not None:
            rig.close()
    return tally


def main():
    parser = fast_options(command_line(__doc__), size="640x512", exposure_us=2000.0)
    parser.add_argument(
        "--sequences", type=int, default=200, help="recordings of one sequence each"
    )
    parser.add_argument("--buffers", type=int, help="most buffers that the GenTL producer accepts")
    parser.add_argument("--lose", type=float, default=0.0, help="share of lost frames")
    parser.add_argument("--seed", type=int, default=1, help="seed of the choice of lost frames")
    parser.add_argument(
        "--out", type=Path, help="folder for the sessions; default: a temporary folder"
    )
    busy_option(parser)
    options = parser.parse_args()
    began = time.monotonic()
    with (
        tempfile.TemporaryDirectory(prefix="sgp-stress-", dir=options.out) as out,
        busy(options.busy),
    ):
        tally = stress(options, Path(out))
    seconds = time.monotonic() - began
    own_s = options.sequences * (options.lights + 2) / options.rate
    print(
        f"{options.sequences} sequences of {options.lights}, a dark frame and a repeat, "
        f"{options.size}, at {options.rate:g} frames/s, {options.busy} other busy processes: "
        f"{seconds:.0f} s, {seconds / own_s:.2f} times the camera's own time\n"
        f"  recordings ended                {tally.ended}\n"
        f"  frames kept                     {tally.frames}\n"
        f"  frames under a wrong LED        {tally.wrong}\n"
        f"  sessions damaged or incomplete  {tally.damaged}\n"
        f"  LEDs left on                    {tally.left_on}\n"
        f"  frames lost, then taken again   {tally.lost}, {tally.retaken}\n"
        f"  pauses for the disk             {tally.pauses}"
    )
    for problem in tally.problems[:20]:
        print(f"  ! {problem}")
    bad = tally.ended or tally.wrong or tally.damaged or tally.left_on
    print("FAILED" if bad else "passed")
    sys.exit(bool(bad))


if __name__ == "__main__":
    main()
