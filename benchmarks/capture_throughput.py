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

import argparse
import shutil
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from acquisition import CapturePlan, Labels, NoiseModel, record, verify_session
from acquisition._pixels.quality import measure_quality
from rig import Board, Rig, RigConfig, open_genicam
from simulator._board.virtual_board import VirtualBoard
from simulator._camera.gentl_camera import GentlCamera, GentlDevice
from simulator._camera.sensor import ImageFormation

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


class Peak:
    """Peak of the process's own memory inside the ``with``."""

    def __enter__(self):
        self.bytes = own_bytes()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()

    def _watch(self):
        while not self._stop.wait(0.005):
            self.bytes = max(self.bytes, own_bytes())


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--lights", type=int, default=36)
    parser.add_argument("--size", default="2448x2048")
    parser.add_argument("--rate", type=float, default=20.0, help="frames per second")
    parser.add_argument("--exposure-us", type=float, default=5000.0)
    parser.add_argument("--passes", type=int, default=3)
    parser.add_argument(
        "--out", type=Path, help="folder for the sessions; default: a temporary folder"
    )
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    frame_bytes = 2 * width * height
    measure_quality(np.zeros((4, 4), np.uint16), white_level_dn=1)
    before = own_bytes()
    out = Path(tempfile.mkdtemp(prefix="sgp-throughput-", dir=options.out))
    bad = 0
    try:
        with (
            VirtualBoard(options.lights) as virtual,
            GentlCamera(
                frames(width, height),
                size=(height, width),
                leds=options.lights,
                precomposed=True,
                bench_state_path=virtual.bench_state_path,
                formation=ImageFormation(NoiseModel(1.0, 0.0, 0.0, 16)),
                device=GentlDevice(frame_rate_hz=options.rate),
            ) as camera,
        ):
            for mode in ("software", "board", "sequence"):
                for number in range(options.passes):
                    folder = out / f"{mode}{number}"
                    bad += one(options, mode, folder, virtual, camera, before, frame_bytes)
                    shutil.rmtree(folder)
    finally:
        shutil.rmtree(out, ignore_errors=True)
    print("FAILED" if bad else "passed")
    sys.exit(bool(bad))


def one(options, mode, folder, virtual, camera, before, frame_bytes):
    """Record one session, print its figures, and return whether they are bad."""
    plan = CapturePlan(
        leds=tuple(range(options.lights)),
        exposures_us=(options.exposure_us,),
        sequence=mode == "sequence",
    )
    trigger = "software" if mode == "software" else "board"
    config = RigConfig(name="fast", driver="bench", leds=options.lights, trigger=trigger)
    own_s = len(plan.shots()) / options.rate
    genicam = open_genicam(camera.cti, pixel_format="Mono16")
    with Peak() as peak, Rig(Board(virtual.port), genicam, config) as rig:
        cpu, began = time.process_time(), time.perf_counter()
        session = record(rig, plan, folder, Labels())
        wall, cpu = time.perf_counter() - began, time.process_time() - cpu
    report = verify_session(folder)
    pauses = [line for line in session.events if line.event == "paused"]
    grown = (peak.bytes - before) / frame_bytes
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
