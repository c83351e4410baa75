"""Soak test: thousands of flashes, some with faults, with the LED of each frame read from pixels.

The rig is the bench's code on virtual devices: pyserial on a pty, harvesters on a GenTL producer.
The plane of each LED encodes its number in pixels of its own, so a frame shows which LEDs were on
and whether they were on for the full exposure. Faults are injected into board, serial line or
camera; a failed shot is taken again. A third of the flashes each is triggered by software, by the
board, and in sequences.

`double-led` is not tested: a board cannot detect two LEDs on one output, but `sgp rig selftest`
does.

Exit code 1 if a frame was attributed to a wrong LED, an LED stayed on, a shot failed without a
fault, or a rig did not recover; or if opening and closing fails, leaves files open, or takes more
memory after the first tenth of the cycles than --growth-mib.
"""

import contextlib
import gc
import random
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
from capture_bench import dark_in_time
from harness import busy, busy_option, command_line, resident_bytes

from acquisition import NoiseModel
from rig import Board, Rig, RigConfig, RigError
from rig.genicam import open_genicam
from simulator.bench import BenchState
from simulator.camera import GentlCamera, GentlDevice, ImageFormation
from simulator.led_board import BoardFault, VirtualBoard

LEDS = 36
BITS = 8
EXPOSURE_US = 500.0
ATTEMPTS = 40

LINE_FAULTS = (
    "drop-command", "double-command", "corrupt-command", "lose-byte-command", "double-byte-command",
    "drop-reply", "double-reply", "corrupt-reply", "lose-byte-reply", "double-byte-reply",
    "delay-reply", "banner", "reset", "reset-after", "hang-up",
)  # fmt: skip
LIGHT_FAULTS = ("wrong-led", "goes-dark")
TRIGGER_FAULTS = ("lose-trigger", "double-trigger")
CAMERA_FAULTS = ("lost", "late", "incomplete", "doubled", "missed", "unplug")
VERBS = {
    "software": ("ON", "OFF"),
    "board": ("FLASH",),
    "sequence": ("STEP", "RUN", "DID"),
}
LIT_BY = {
    "wrong-led": {"software": "ON", "board": "FLASH", "sequence": "STEP"},
    "goes-dark": {"software": "ON", "board": "FLASH", "sequence": "RUN"},
}


def plane(led):
    """Return rows with one pixel for each bit of LED + 1, then one for each inverted bit."""
    code = 0 if led is None else led + 1
    bits = np.array([code >> bit & 1 for bit in range(BITS)], np.float32)
    row = np.concatenate([bits, (1 - bits) * (led is not None)])
    return np.tile(row, (4, 1)).astype(np.float32)


def led_seen(pixels):
    """Return the LED that the pixels show, None for darkness, or a text if it is not one LED."""
    row = pixels[0].astype(int)
    if not (pixels == pixels[0]).all():
        return "rows differ"
    full = round(EXPOSURE_US)  # one electron per microsecond, one per grey value
    if not row.any():
        return None
    bits, opposite = row[:BITS], row[BITS:]
    if not np.isin(row, (0, full)).all() or (bits + opposite != full).any():
        return f"no single LED for the whole exposure: {row.tolist()}"
    return int(sum(1 << bit for bit, value in enumerate(bits) if value)) - 1


class Bench:
    """Virtual devices, and a rig on them that is reopened after it was lost."""

    def __init__(self, mode, frame_timeout_s=0.15):
        self.mode = mode
        self.frame_timeout_s = frame_timeout_s
        self.virtual = VirtualBoard(LEDS)
        self.state = BenchState(self.virtual.bench_state_path)
        self.camera = GentlCamera(
            plane,
            size=(4, 2 * BITS),
            leds=LEDS,
            bench_state_path=self.virtual.bench_state_path,
            formation=ImageFormation(NoiseModel(1.0, 0.0, 0.0, 12), noisy=False),
            device=GentlDevice(frame_rate_hz=500),
        )
        self.rig = None
        self.opened = 0

    def open(self):
        """Return an open rig; a board that hung up needs a moment to recover."""
        if self.rig is None:
            self.camera.replug()
            config = RigConfig(
                name="soak",
                driver="bench",
                leds=LEDS,
                settle_ms=0.2,
                frame_timeout_s=self.frame_timeout_s,
                trigger="software" if self.mode == "software" else "board",
            )
            device = open_genicam(self.camera.cti)
            try:
                board = Board(self.virtual.port)
            except BaseException:
                device.close()
                raise
            self.rig = Rig(board, device, config)
            self.opened += 1
        return self.rig

    def drop(self):
        """Close a rig that failed."""
        if self.rig is not None:
            with contextlib.suppress(RigError):
                self.rig.close()
            self.rig = None

    def dark_in_time(self):
        """Return whether the bench is dark by the time at which the board's watchdog acts."""
        return dark_in_time(self.state)

    def close(self):
        self.drop()
        self.state.close()
        self.camera.close()
        self.virtual.close()


def draw_fault(draw, mode, at):
    """Return a kind and a fault of the board, or of the camera as (frame, kind, late_ms)."""
    triggers = () if mode == "software" else TRIGGER_FAULTS
    kind = draw.choice((*CAMERA_FAULTS, *LINE_FAULTS, *LIT_BY, *triggers))
    if kind in CAMERA_FAULTS:
        return kind, (at, kind, draw.choice((5, 100, 300)))
    verb = LIT_BY[kind][mode] if kind in LIT_BY else draw.choice(VERBS[mode])
    value = {
        "delay-reply": draw.choice((20, 260)),
        "wrong-led": draw.randrange(LEDS),
        "goes-dark": 0,
        "hang-up": 100,
        "double-trigger": draw.choice((300, 2500)),
    }.get(kind, draw.randrange(20))
    skip = at if verb in ("STEP", "DID") or kind in TRIGGER_FAULTS else 0
    return kind, BoardFault(kind=kind, verb=verb, skip=skip, value=value)


def strike(bench, faults):
    """Inject these faults into the next flashes."""
    first = bench.camera.counts().exposures
    for _, fault in faults:
        if isinstance(fault, tuple):
            at, kind, late_ms = fault
            bench.camera.set_fault(first + at, kind, late_ms=late_ms)
    bench.virtual.set_faults(*(fault for _, fault in faults if isinstance(fault, BoardFault)))


class Tally:
    def __init__(self):
        self.frames = self.flashes = self.wrong = self.left_on = self.failures = 0
        self.recovered, self.reported = Counter(), Counter()
        self.problems = []
        self.shaken = False  # whether the previous burst had faults
        self.doing = ""

    def frame(self, asked, shot):
        self.frames += 1
        seen = led_seen(shot.frame.pixels)
        if not (seen == asked == shot.led):
            self.wrong += 1
            self.problems.append(
                f"{self.doing}: requested LED {asked}, reported LED {shot.led}, the pixels show "
                f"{seen}"
            )


def take(bench, leds, tally):
    """Take frames of these LEDs until a shot fails; return how many were taken."""
    rig = bench.open()
    if bench.mode == "sequence":
        done = 0
        for asked, shot in zip(leds, rig.sequence(leds, EXPOSURE_US), strict=True):
            tally.frame(asked, shot)
            done += 1
        return done
    tally.frame(leds[0], rig.shoot(leds[0], EXPOSURE_US))
    return 1


def burst(bench, leds, faults, tally):
    """Take frames of these LEDs; after a failed shot continue with the remaining ones."""
    bench.open()
    strike(bench, faults)
    tally.doing = f"{bench.mode}, {[fault for _, fault in faults]}"
    failures = 0
    for _ in range(ATTEMPTS):
        taken = tally.frames
        try:
            take(bench, leds, tally)
        except RigError as error:
            failures += 1
            # A frame that is delivered twice is detected only when the next flash begins.
            if not (faults or tally.shaken):
                tally.problems.append(f"{bench.mode}, failed without a fault: {error}")
            if not bench.dark_in_time():
                tally.left_on += 1
            leds = leds[tally.frames - taken :]
            bench.drop()
            time.sleep(0.12)  # a board that hung up recovers
            if leds:
                continue
        break
    else:
        tally.problems.append(f"not recovered from {[kind for kind, _ in faults]}")
    if faults:
        bench.virtual.set_faults()
    if not bench.dark_in_time():
        tally.left_on += 1
    tally.failures += failures
    tally.shaken = bool(faults)
    for kind, _ in faults:
        # If a sequence had several faults, it is not known which one made it fail.
        outcome = tally.reported if failures else tally.recovered
        outcome[kind] += 1


def soak(flashes, share, seed):
    draw = random.Random(seed)
    tally = Tally()
    began = time.monotonic()
    for mode in VERBS:
        bench = Bench(mode)
        size = 36 if mode == "sequence" else 1
        try:
            for first in range(0, flashes // 3, size):
                leds = [draw.choice([*range(LEDS), None]) for _ in range(size)]
                hit = [at for at in range(size) if draw.random() < share]
                burst(bench, leds, [draw_fault(draw, mode, at) for at in hit], tally)
                tally.flashes += size
                if sys.stderr.isatty() and first % 144 == 0:
                    print(f"\r{mode} {first}", end="", file=sys.stderr)
        finally:
            bench.close()
    return tally, time.monotonic() - began


def held():
    """Return the resident memory in MiB and the number of open files."""
    gc.collect()
    return resident_bytes() / 2**20, len(list(Path("/proc/self/fd").iterdir()))


def cycles(count, growth_mib):
    """Open and close the rig many times, print memory and open files, and return problems."""
    # There are no faults here, so a frame may take as long as a busy machine needs.
    bench = Bench("software", frame_timeout_s=10.0)
    began = time.monotonic()
    warm_mib, warm_files = 0.0, 0
    try:
        for cycle in range(count):
            bench.open().shoot(cycle % LEDS, EXPOSURE_US)
            bench.drop()
            if cycle == count // 10:
                warm_mib, warm_files = held()
        end_mib, files = held()
    except RigError as error:
        return [f"cycle {cycle + 1} of opening and closing: {error}"]
    finally:
        bench.close()
    print(
        f"{count} times opened, one frame taken, closed in {time.monotonic() - began:.0f} s: "
        f"{warm_mib:.1f} MiB after a tenth, {end_mib:.1f} at the end ({end_mib - warm_mib:+.1f}), "
        f"{warm_files} open files, then {files}"
    )
    problems = []
    if end_mib - warm_mib > growth_mib:
        problems.append(f"{end_mib - warm_mib:.1f} MiB more than after a tenth of the cycles")
    if files > warm_files:
        problems.append(f"{files - warm_files} more open files than after a tenth of the cycles")
    return problems


def main():
    parser = command_line(__doc__)
    parser.add_argument("--flashes", type=int, default=10_000, help="flashes of all three kinds")
    parser.add_argument("--share", type=float, default=0.05, help="share of flashes with a fault")
    parser.add_argument("--cycles", type=int, default=1000, help="cycles of opening and closing")
    parser.add_argument(
        "--growth-mib", type=float, default=16.0, help="allowed growth after a tenth of the cycles"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of LEDs and faults")
    busy_option(parser)
    options = parser.parse_args()
    with busy(options.busy):
        return run(options)


def run(options):
    tally, seconds = soak(options.flashes, options.share, options.seed)
    faults = sum((tally.reported + tally.recovered).values())
    print(f"{tally.flashes} flashes in {seconds:.0f} s, {faults} faults injected")
    print(f"  frames taken                          {tally.frames}")
    print(f"  frames attributed to the wrong LED    {tally.wrong}")
    print(f"  LEDs left on                          {tally.left_on}")
    print(f"  faults reported (a shot failed)       {tally.reported.total()}")
    print(f"  faults recovered from (no shot failed){tally.recovered.total()}")
    print(f"  failures reported                     {tally.failures}")
    for kind in sorted(tally.reported | tally.recovered):
        print(
            f"    {kind:<22} reported {tally.reported[kind]:4d}  recovered "
            f"{tally.recovered[kind]:4d}"
        )
    problems = tally.problems[:20]
    if options.cycles:
        problems += cycles(options.cycles, options.growth_mib)
    for problem in problems:
        print(f"  ! {problem}")
    return 1 if tally.wrong or tally.left_on or problems else 0


if __name__ == "__main__":
    raise SystemExit(main())
