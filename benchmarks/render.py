"""What rendering costs, in copies of the stack it makes, and how it grows with the image.

python benchmarks/render.py [--megapixels 1] [--lights 36] [--large 20]

CPU seconds are of all threads together; set NUMBA_NUM_THREADS for their number. The object is the
coin, which fills two thirds of the field; `steep` has four times its relief, so that a fifth of it
lies in some light's shadow. Sizes up to --large megapixels are drawn with few lights.
"""

import argparse
import ctypes
import time
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np

from simulator import Coin, render, scene_named

MIB = 2.0**20


def _status_mib(field):
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return float("nan")
    return next(float(line.split()[1]) for line in lines if line.startswith(field)) / 1024


def measured(work):
    """Return CPU seconds, wall seconds, growth of peak memory in MiB, and what the work gave."""
    try:
        ctypes.CDLL(None).malloc_trim(0)  # memory that is kept for reuse would hide the growth
        Path("/proc/self/clear_refs").write_text("5")
    except (OSError, AttributeError):
        print("(peak memory is not measured on this system)")
    before = _status_mib("VmRSS")
    cpu, wall = time.process_time(), time.perf_counter()
    made = work()
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    return cpu, wall, _status_mib("VmHWM") - before, made


def copy_seconds(values):
    target = np.zeros_like(values)
    return min(measured(lambda: np.copyto(target, values))[0] for _ in range(3))


def scenes(megapixels, lights):
    width = round((megapixels * 1e6 * 5 / 4) ** 0.5)
    coin = scene_named("coin", width=width, height=round(width * 4 / 5), leds=lights)
    steep = replace(coin, body=Coin(80.0, relief_mm=2.0))
    return {
        "without cast shadows": replace(coin, shadows=False),
        "with cast shadows": coin,
        "with cast shadows, steep": steep,
        "soft shadows, 16 samples": replace(steep, soft_shadow_samples=16),
        "spheres": scene_named("spheres", width=width, height=round(width * 4 / 5), leds=lights),
    }


def row(name, scene, copies=True):
    cpu, wall, peak, made = measured(lambda: render(scene))
    planes = made.planes
    copy = f"{cpu / copy_seconds(planes):9.0f}" if copies else ""
    pixels = planes[0].size
    print(
        f"{name:28}{cpu:8.2f}{wall:8.2f}{cpu / pixels * 1e6:8.2f}"
        f"{cpu / planes.size * 1e9:10.1f}{peak / (planes.nbytes / MIB):8.2f}{copy}"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--megapixels", type=float, default=1.0)
    parser.add_argument("--lights", type=int, default=36)
    parser.add_argument("--large", type=float, default=20.0)
    options = parser.parse_args()
    for scene in scenes(0.003, 2).values():  # compiles
        render(scene)
    print(f"{numba.get_num_threads()} threads\n")
    head = f"{'':28}{'CPU s':>8}{'wall s':>8}{'us/px':>8}{'ns/sample':>10}{'peak/N':>8}"
    print(head + f"{'copies':>9}   {options.lights} lights x {options.megapixels:g} Mpx")
    for name, scene in scenes(options.megapixels, options.lights).items():
        row(name, scene)
    print("\n" + head + "   4 lights")
    sizes = [size for size in (0.3, 1.0, 5.0, 20.0) if size <= options.large]
    for size in sizes:
        made = scenes(size, 4)
        for name in ("without cast shadows", "with cast shadows"):
            row(f"{size:g} Mpx {name}", made[name], copies=False)


if __name__ == "__main__":
    main()
