"""Cost of photometric stereo, in copies of its stack, and its accuracy on real captures.

CPU seconds are those of all threads together; NUMBA_NUM_THREADS sets their number. "peak MiB" is
the growth of the resident memory. "numpy pinv" and "float64 lstsq" are plain least squares on the
same stack. The accuracy part runs if the variable SGP_DATA names the folder of the data; the row
of 36 lights is the mean of three random choices.
"""

import os
from pathlib import Path

import numba
import numpy as np
from harness import command_line, copy_s, measured

from acquisition import Lights, read_source
from calibration import StackNoise, linear_stack
from processing import StereoMaps, angular_error, normals_of_frames, photometric_stereo
from processing.stereo import METHODS

MIB = 2.0**20


def dome(count):
    z = np.linspace(0.97, 0.5, count)
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)


def bumpy_stack(directions, height, width, leds=None, points=None):
    """Return a stack of a relief with attached shadows and noise, rendered image by image."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:height, :width].astype(np.float32)
    normals = np.stack([0.8 * np.sin(x / 9), 0.8 * np.cos(y / 13), np.ones_like(x)])
    normals /= np.linalg.norm(normals, axis=0)
    values = np.zeros((len(directions), height, width), np.float32)
    for i, (image, light) in enumerate(zip(values, directions, strict=True)):
        if leds is None:
            shading = np.tensordot(light.astype(np.float32), normals, 1)
        else:
            of = leds.take([i]).vectors_at(points).reshape(height, width, 3)
            shading = np.einsum("hwc,chw->hw", of, normals)
        image[:] = np.maximum(shading, 0)
        image += rng.normal(0, 0.01, image.shape).astype(np.float32)
    return values


def naive(values, directions):
    """Solve plain least squares by one matrix product, for comparison."""
    inverse = np.linalg.pinv(directions).astype(np.float32)
    m = inverse @ values.reshape(len(values), -1)
    length = np.linalg.norm(m, axis=0)
    return m / length, length


def cost(lights, megapixels):
    side = round((megapixels * 1e6) ** 0.5)
    directions = dome(lights)
    values = bumpy_stack(directions, side, side)
    mask = np.ones((side, side), bool)
    saturated = values.copy()
    saturated[values > 0.97] = np.nan
    distant = Lights(directions)
    leds = Lights(positions_mm=directions * 450, mu=np.full(lights, 1.0))
    x, y = np.meshgrid(np.linspace(-70, 70, side), np.linspace(70, -70, side))
    points = np.stack([x, y, 0 * x], axis=2)
    of_leds = bumpy_stack(directions, side, side, leds, points)
    rows = {
        **{
            method: lambda method=method: photometric_stereo(values, distant, mask, method=method)
            for method in METHODS
        },
        "ls, saturated samples": lambda: photometric_stereo(saturated, distant, mask, method="ls"),
        **{
            f"{method}, near LEDs": lambda method=method: photometric_stereo(
                of_leds, leds, mask, method=method, points_mm=points
            )
            for method in METHODS
        },
        "ls, known noise": lambda: photometric_stereo(
            values, distant, mask, method="ls", noise=noise
        ),
        "best, known noise": lambda: photometric_stereo(
            values, distant, mask, method="best", noise=noise
        ),
        "cauchy, known noise": lambda: photometric_stereo(
            values, distant, mask, method="cauchy", noise=noise
        ),
        "numpy pinv": lambda: naive(values, directions),
        "float64 lstsq": lambda: np.linalg.lstsq(
            directions, values.reshape(len(values), -1).astype(np.float64), rcond=None
        ),
    }
    noise = StackNoise.of_one_exposure(0, 1e-4, lights)
    for method in METHODS:
        photometric_stereo(values[:, :1], distant, mask[:1], method=method)  # compiles
    copy = copy_s(values)
    print(
        f"{lights} lights x {side} x {side} float32 ({values.nbytes / MIB:.0f} MiB), "
        f"{numba.get_num_threads()} threads; one copy {copy * 1e3:.1f} ms\n"
    )
    print(f"{'':24}{'CPU s':>8}{'wall s':>8}{'us/px':>8}{'copies':>8}{'peak MiB':>10}")
    for name, work in rows.items():
        taken, _ = measured(work, runs=2)
        print(
            f"{name:24}{taken.cpu_s:8.3f}{taken.wall_s:8.3f}{taken.cpu_s / mask.size * 1e6:8.3f}"
            f"{taken.cpu_s / copy:8.1f}{taken.peak_bytes / MIB:10.0f}"
        )


def latency(lights, side):
    """Print the time from frames of 12 bits in memory to maps, as in an inspection line."""
    directions = dome(lights)
    values = bumpy_stack(directions, side, side)
    frames = np.clip(64 + 3800 * values, 0, 4095).astype(np.uint16)
    out = StereoMaps.empty((side, side))
    half = side // 2
    print(f"\nnormals_of_frames, {lights} x {side} x {side} uint16, maps given")
    for text, region in (("all pixels", None), ("a quarter", (half // 2, half // 2, half, half))):
        maps = out if region is None else StereoMaps.empty((half, half))
        times = []
        for _ in range(6):
            taken, _ = measured(
                lambda region=region, maps=maps: normals_of_frames(
                    frames, Lights(directions), dark=64, saturation=4095, region=region, out=maps
                ),
                runs=1,
            )
            times.append((taken.wall_s, taken.cpu_s))
        wall, cpu = np.array(times[1:]).T * 1e3
        print(
            f"{text:24}median {np.median(wall):6.1f} ms, largest {wall.max():6.1f} ms, "
            f"CPU {np.median(cpu):6.1f} ms"
        )


def accuracy(folder):
    print(f"\n{'mean angular error, deg':24}" + "".join(f"{name:>9}" for name in METHODS))
    for name in ("bearPNG", "catPNG"):
        source = read_source(folder / name)
        stack = linear_stack(source)
        choices = {
            "96 lights": [np.arange(96)],
            "lights 20 to 96": [np.arange(20, 96)],
            "36 lights": [
                np.sort(np.random.default_rng(seed).choice(96, 36, replace=False))
                for seed in range(3)
            ],
        }
        for text, choice in choices.items():
            errors = [
                [
                    angular_error(
                        photometric_stereo(
                            stack.values[kept], stack.lights.take(kept), source.mask, method=method
                        ).normal_map,
                        source.normals_truth,
                        source.mask,
                    ).mae_deg
                    for method in METHODS
                ]
                for kept in choice
            ]
            row = "".join(f"{error:9.2f}" for error in np.mean(errors, axis=0))
            print(f"{f'{name}, {text}':24}{row}")


def main():
    parser = command_line(__doc__)
    parser.add_argument("--megapixels", type=float, default=1.0, help="megapixels per image")
    parser.add_argument("--lights", type=int, default=36, help="number of images")
    options = parser.parse_args()
    cost(options.lights, options.megapixels)
    latency(options.lights, round((options.megapixels * 1e6) ** 0.5))
    if "SGP_DATA" in os.environ:
        accuracy(Path(os.environ["SGP_DATA"]) / "diligent")
    else:
        print("\nSGP_DATA is not set: real captures are not measured")


if __name__ == "__main__":
    main()
