"""Shared parts of the capture benchmarks: a small simulated rig in processes that can be killed."""

import json
import os
import sys
import time
import traceback
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from acquisition import CapturePlan, Labels, NoiseModel, Session, verify_session
from acquisition.pixels import measure_quality
from rig import RigConfig
from simulator import simulated_rig
from simulator.bench import BenchState
from simulator.camera import GentlCamera, GentlDevice, ImageFormation
from simulator.led_board import VirtualBoard

LEDS = 36
SIZE = (48, 64)
EXPOSURE_US = 2000.0
NOISE = NoiseModel(1.0, 0.0, 64.0, 12)
PLAN = CapturePlan(leds=tuple(range(LEDS)), exposures_us=(EXPOSURE_US,))
# Grey values are whole numbers, and the sensor works in single precision.
ROUNDING_DN = 0.51
# How an exposure is started: by software, by the board, or in a sequence that the board runs.
MODES = ("software", "board", "sequence")
# The watchdog turns LEDs off within a second; no LED may stay on for longer after its shot.
LEFT_ON_S = 1.25
LABELS = Labels("benchmark", "planes")
# Compile here once, instead of once in every forked process.
measure_quality(np.zeros((4, 4), np.uint16), white_level_dn=1)


def plane(led):
    """Return the light of an LED, photons per microsecond; all LEDs differ and no one is black."""
    if led is None:
        return np.full(SIZE, 0.005, np.float32)
    return np.random.default_rng(led).uniform(0.1, 1.8, SIZE).astype(np.float32)


def expected(led):
    """Return the noiseless frame of an LED in grey values, computed without the simulator."""
    electrons = plane(None).astype(np.float64) * EXPOSURE_US
    if led is not None:
        electrons += plane(led).astype(np.float64) * EXPOSURE_US
    return np.clip(electrons + NOISE.black_level_dn, 0, 4095)


def plan_for(mode):
    """Return the plan of a mode."""
    return PLAN.changed(sequence=mode == "sequence")


def open_planes(mode="software", camera="auto"):
    """Open a simulated rig that shows the planes without noise."""
    trigger = "software" if mode == "software" else "board"
    config = RigConfig(name="planes", driver="simulated", leds=LEDS, settle_ms=0.5, trigger=trigger)
    return simulated_rig(
        plane, config, size=SIZE, formation=ImageFormation(NOISE, noisy=False), camera=camera
    )


def fast_options(parser, *, size="2448x2048", exposure_us=5000.0):
    """Add the options of a virtual camera that delivers precomposed frames, and its lights."""
    parser.add_argument("--lights", type=int, default=36, help="shots per pass")
    parser.add_argument("--size", default=size, help="image size in pixels")
    parser.add_argument("--rate", type=float, default=20.0, help="frames per second")
    parser.add_argument(
        "--exposure-us", type=float, default=exposure_us, help="exposure time per shot"
    )
    return parser


@contextmanager
def fast_bench(options, frames, **device):
    """Open a virtual board, and a camera that delivers precomposed frames at a limited rate."""
    width, height = map(int, options.size.split("x"))
    with (
        VirtualBoard(options.lights) as virtual,
        GentlCamera(
            frames,
            size=(height, width),
            leds=options.lights,
            precomposed=True,
            bench_state_path=virtual.bench_state_path,
            formation=ImageFormation(NoiseModel(1.0, 0.0, 0.0, 16)),
            device=GentlDevice(frame_rate_hz=options.rate, **device),
        ) as camera,
    ):
        yield virtual, camera


def bench_of(rig):
    """Return the path of a simulated rig's bench state, in the folder of the board's port."""
    return Path(rig.board.port).parent / "bench.state"


def forked(work):
    """Run work in a forked process and return its id; it exits with 0, or 1 after an error."""
    sys.stdout.flush()
    pid = os.fork()
    if pid:
        return pid
    code = 1
    try:
        work()
        code = 0
    except BaseException:  # noqa: BLE001 - the child must not continue as its parent
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def ended(pid):
    """Wait for a process and return its exit status in the form of `subprocess`."""
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def wait_for(path, timeout_s=60.0):
    """Wait until a file exists and is complete, and return its JSON content."""
    ends_s = time.monotonic() + timeout_s
    while time.monotonic() < ends_s:
        with suppress(FileNotFoundError, json.JSONDecodeError):
            return json.loads(path.read_text())
        time.sleep(0.001)
    raise SystemExit(f"{path} did not appear within {timeout_s:g} s")


def last_light_ns(state, path, timeout_s=10.0):
    """Wait until the board's process has ended, and return the time of the last light's end.

    ``state`` must be opened while the board runs, because its file disappears with the board.
    """
    ends_s = time.monotonic() + timeout_s
    while path.exists():
        if time.monotonic() > ends_s:
            raise SystemExit(f"the virtual board of {path} still runs after {timeout_s:g} s")
        time.sleep(0.005)
    return max((period.end_ns for period in state.periods()), default=0)


def dark_in_time(state):
    """Return whether a bench is dark by the time at which the board's watchdog acts."""
    ends_s = time.monotonic() + LEFT_ON_S
    while state.led(time.monotonic_ns()) is not None:
        if time.monotonic() > ends_s:
            return False
        time.sleep(0.002)
    return True


def open_state(path):
    """Open a bench state."""
    return BenchState(Path(path))


def wrong_frames(folder):
    """Return a line for each frame that counts but does not have the pixels of its LED."""
    return [
        f"{frame.path}: does not have the pixels of LED {frame.led}"
        for frame in Session.open(folder).frames
        if np.abs(frame.read() - expected(frame.led)).max() > ROUNDING_DN
    ]


def is_complete(folder):
    """Return whether a session verifies as complete."""
    report = verify_session(folder)
    return report.ok and report.complete and not report.missing
