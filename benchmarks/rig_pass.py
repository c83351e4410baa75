"""A pass over all lights: measure the time that the rig adds to the camera's own time.

The virtual camera delivers precomposed frames, at most --rate per second. Its own time is one frame
period per light. CPU seconds are those of this process, including the camera's threads.

Exit code 1 if the board's sequence takes more than 1.15 times the camera's own time, or single
shots triggered by software more than 1.5 times.
"""

import statistics
import time

import numpy as np
from capture_bench import fast_bench, fast_options
from harness import command_line

from rig import Board, Rig, RigConfig
from rig.genicam import open_genicam

PASSES = 3
# Limits, in multiples of the camera's own time.
MOST = {"software": 1.5, "sequence": 1.15}


def frames(width, height):
    def frame(led):
        return np.full((height, width), 0 if led is None else led + 1, np.uint16)

    return frame


def taken(rig, mode, leds, exposure_us):
    """Yield the shots of one pass."""
    if mode == "sequence":
        yield from rig.sequence(leds, exposure_us)
    else:
        for led in leds:
            yield rig.shoot(led, exposure_us)


def main():
    options = fast_options(command_line(__doc__)).parse_args()
    width, height = map(int, options.size.split("x"))
    own_s = options.lights / options.rate
    leds = list(range(options.lights))
    print(
        f"{options.lights} lights, {width} x {height}, {options.exposure_us:g} us, camera of "
        f"{options.rate:g} frames/s: its own time is {own_s:.2f} s; median of {PASSES} passes"
    )
    with fast_bench(options, frames(width, height)) as (virtual, camera):
        slow = []
        for mode in ("software", "board", "sequence"):
            config = RigConfig(
                name="pass",
                driver="bench",
                leds=options.lights,
                trigger="software" if mode == "software" else "board",
            )
            with Rig(
                Board(virtual.port), open_genicam(camera.cti, pixel_format="Mono16"), config
            ) as rig:
                walls, busy = [], []
                for _ in range(PASSES):
                    wall, cpu = time.perf_counter(), time.process_time()
                    for led, shot in zip(
                        leds, taken(rig, mode, leds, options.exposure_us), strict=True
                    ):
                        seen = int(shot.frame.pixels[0, 0]) - 1
                        if not led == shot.led == seen:
                            raise SystemExit(
                                f"LED {led}: reported as {shot.led}, the frame shows {seen}"
                            )
                    walls.append(time.perf_counter() - wall)
                    busy.append(time.process_time() - cpu)
            wall = statistics.median(walls)
            print(
                f"  {mode:<10} {wall:6.2f} s = {wall / own_s:.3f} of the camera's time "
                f"({min(walls):.2f} to {max(walls):.2f}), {statistics.median(busy):.2f} CPU s"
            )
            if mode in MOST and wall > MOST[mode] * own_s:
                slow.append(mode)
    for mode in slow:
        print(f"  ! {mode} takes more than {MOST[mode]:g} times the camera's time")
    return 1 if slow else 0


if __name__ == "__main__":
    raise SystemExit(main())
