"""Record at full size: check that writing keeps up with the camera, and measure the memory.

python benchmarks/capture_throughput.py [--lights 36] [--size 2448x2048] [--rate 20]
    [--exposure-us 5000] [--passes 3] [--out DIR]

The virtual camera delivers precomposed frames, at most --rate per second; its own time is one
period per shot. The wall time is from the first shot to the session's COMPLETE and includes hashes,
flushes and the journal. Memory is the process's own memory (RssAnon) minus its value after all
imports and before anything is opened: the queue and camera buffers count, the file from which the
virtual camera plays its frames does not.

Exit code 1 if writing caused a pause, if memory grew by 12 frames or more (in sequences by 12 more
than the frames of the sequence, because each frame has a buffer), or if a sequence took more than
1.15 times the camera's own time.
"""

import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from capture_bench import fast_bench, fast_options
from harness import command_line, largest

from acquisition import CapturePlan, Labels, record, verify_session
from rig import Board, Rig, RigConfig
from rig.genicam import open_genicam

MOST_TIMES_CAMERA = 1.15
MOST_FRAMES = 12


def frames(width, height):
    """Return a function that gives noisy ramps; those of the lights differ by an offset."""
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 200, (height, width)).astype(np.uint16)
    ramp = np.linspace(500, 3000, width).astype(np.uint16)[None, :]

    def frame(led):
        return noise + np.uint16(64) if led is None else noise + ramp + np.uint16(led)

    return frame


def own_bytes():
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("RssAnon"):
            return int(line.split()[1]) * 1024
    raise SystemExit("this system does not report a process's own memory (RssAnon)")


def main():
    parser = fast_options(command_line(__doc__))
    parser.add_argument("--passes", type=int, default=3)
    parser.add_argument(
        "--out", type=Path, help="folder for the sessions; default: a temporary folder"
    )
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    frame_bytes = 2 * width * height
    before = own_bytes()
    bad = 0
    with (
        tempfile.TemporaryDirectory(prefix="sgp-throughput-", dir=options.out) as out,
        fast_bench(options, frames(width, height)) as (virtual, camera),
    ):
        for mode in ("software", "board", "sequence"):
            for number in range(options.passes):
                folder = Path(out) / f"{mode}{number}"
                bad += one(options, mode, folder, virtual, camera, before, frame_bytes)
                shutil.rmtree(folder)
    print("FAILED" if bad else "passed")
    sys.exit(bool(bad))


def one(options, mode, folder, virtual, camera, before, frame_bytes):
    """Record one session, print its figures, and return whether they are bad."""
    plan = CapturePlan(
        leds=tuple(range(options.lights)),
        exposures_us=(options.exposure_us,),
        sequence=mode == "sequence",
        repeat=False,  # its comparison is no writing
    )
    trigger = "software" if mode == "software" else "board"
    config = RigConfig(name="fast", driver="bench", leds=options.lights, trigger=trigger)
    own_s = len(plan.shots()) / options.rate
    genicam = open_genicam(camera.cti, pixel_format="Mono16")
    with largest(own_bytes, 0.005) as peak, Rig(Board(virtual.port), genicam, config) as rig:
        cpu, began = time.process_time(), time.perf_counter()
        session = record(rig, plan, folder, Labels())
        wall, cpu = time.perf_counter() - began, time.process_time() - cpu
    report = verify_session(folder)
    pauses = [line for line in session.events if line.event == "paused"]
    grown = (peak[0] - before) / frame_bytes
    print(
        f"{mode:<9} {report.frames} frames of {frame_bytes / 1e6:.1f} MB in {wall:.2f} s = "
        f"{wall / own_s:.3f} of the camera's {own_s:.2f} s, {cpu / report.frames * 1000:.0f} ms "
        f"CPU per frame, {len(pauses)} pauses, memory +{grown:.1f} frames"
    )
    complete = report.ok and report.complete
    most = MOST_FRAMES + (len(plan.shots()) if mode == "sequence" else 0)
    slow = mode == "sequence" and wall > MOST_TIMES_CAMERA * own_s
    return not complete or slow or bool(pauses) or grown >= most


if __name__ == "__main__":
    main()
