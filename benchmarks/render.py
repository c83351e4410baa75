"""Cost of rendering, in copies of the rendered stack, and its growth with the image size.

CPU seconds are those of all threads together; NUMBA_NUM_THREADS sets their number. The object is
the coin, which fills two thirds of the image; `steep` has four times its relief, so that a fifth of
it is in the shadow of some light. Sizes up to --large megapixels are rendered with few lights.
"""

from dataclasses import replace

import numba
from harness import command_line, copy_s, measured

from simulator import render, scene_named
from simulator.shapes import Coin


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
    cost, rendering = measured(lambda: render(scene))
    planes = rendering.planes
    copy = f"{cost.cpu_s / copy_s(planes):9.0f}" if copies else ""
    print(
        f"{name:28}{cost.cpu_s:8.2f}{cost.wall_s:8.2f}{cost.cpu_s / planes[0].size * 1e6:8.2f}"
        f"{cost.cpu_s / planes.size * 1e9:10.1f}{cost.peak_bytes / planes.nbytes:8.2f}{copy}"
    )


def main():
    parser = command_line(__doc__)
    parser.add_argument("--megapixels", type=float, default=1.0, help="megapixels per image")
    parser.add_argument("--lights", type=int, default=36, help="number of images")
    parser.add_argument(
        "--large", type=float, default=20.0, help="largest image of the second table, megapixels"
    )
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
        sized = scenes(size, 4)
        for name in ("without cast shadows", "with cast shadows"):
            row(f"{size:g} Mpx {name}", sized[name], copies=False)


if __name__ == "__main__":
    main()
