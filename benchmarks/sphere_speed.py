"""CPU time and memory of `sgp calibrate spheres`, compared with reading the images alone.

The simulator renders four chrome spheres on a card at 5472 x 3648 px, which costs about ten CPU
seconds for each light, so that --rendered lights are repeated until there are --lights of them.
Their images are uncompressed TIFFs of 16 bits (or PNGs: --png), and are kept in --folder for the
next run. The highlights are saturated, as in one short exposure.

Each row is measured in a process of its own (the command with its start), and is given in CPU
seconds of all threads, in multiples of the yardstick, and with its peak of memory:

- bytes: the bytes of all files are read, without decoding them;
- memory: an array of the size of the linear stack, float32, is filled once; pages that a process
  touches first cost most of it, on virtual machines several times as much as on others;
- images: `linear_images` one after the other, which are dropped. This is the yardstick;
- command: `sgp calibrate spheres`, from the files to lights.json and lights.png.

The limit of the project is 20 CPU seconds for 36 images, reading included.

With --chrome, the images are 12 JPEGs of 1.1 Mpx of one large ball without a plane: those of the
University of Washington ($SGP_DATA/uw/chrome), enlarged 2.5 times. The limit is 4 CPU seconds.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from harness import Cost, alone, command_line, measured

from acquisition import read_image, read_lights, read_source, write_camera, write_lights

WIDTH, HEIGHT = 5472, 3648
CARD_DN, WHITE_DN = 6000, 65535
RADII_MM = (20, 20, 16, 14)


def write_recording(folder: Path, lights: int, rendered: int, suffix: str) -> None:
    """Write the images, the camera and the true lights; files that exist are kept."""
    from simulator import render, scene_named

    images = folder / "images"
    images.mkdir(parents=True, exist_ok=True)
    scene = scene_named("spheres", width=WIDTH, height=HEIGHT, leds=rendered)
    write_lights(folder / "truth.json", scene.lights)
    flags = [cv2.IMWRITE_TIFF_COMPRESSION, 1] if suffix == ".tif" else []
    for led in range(rendered):
        path = images / f"L{led:02d}{suffix}"
        if not path.exists():
            rendering = render(replace(scene, lights=scene.lights.take([led])))
            write_camera(folder / "camera.json", rendering.truth.camera)
            dn = rendering.planes[0] * (CARD_DN / float(np.median(rendering.planes[0])))
            noise = np.random.default_rng(led).normal(0, 1, dn.shape).astype(np.float32)
            dn += noise * np.sqrt(4 + dn)
            cv2.imwrite(str(path), np.clip(np.rint(dn), 0, WHITE_DN).astype(np.uint16), flags)
    for led in range(rendered, lights):
        copy = images / f"L{led:02d}{suffix}"
        if not copy.exists():
            shutil.copyfile(images / f"L{shown_by(led, rendered):02d}{suffix}", copy)


def write_chrome(images: Path) -> None:
    """Write the chrome ball of the University of Washington, enlarged, as JPEGs."""
    images.mkdir(parents=True, exist_ok=True)
    for path in sorted((Path(os.environ["SGP_DATA"]) / "uw" / "chrome").glob("chrome.*.tga")):
        if "mask" not in path.name:
            image = cv2.cvtColor(read_image(path), cv2.COLOR_RGB2BGR)
            large = cv2.resize(image, None, fx=2.5, fy=2.5, interpolation=cv2.INTER_CUBIC)
            cv2.imwrite(str(images / f"{path.stem}.jpg"), large, [cv2.IMWRITE_JPEG_QUALITY, 92])


def shown_by(led: int, rendered: int) -> int:
    """Return the rendered light whose image a light has.

    The order changes from one repetition to the next: the search looks at every third light.
    """
    return (led + led // rendered) % rendered


def cost_of_bytes(images: Path) -> Cost:
    """Return the cost of reading the files."""
    return measured(lambda: sum(len(path.read_bytes()) for path in images.iterdir()))[0]


def cost_of_memory(images: int) -> Cost:
    """Return the cost of filling an array of the size of the stack."""

    def fill() -> None:
        np.zeros((images, HEIGHT, WIDTH), np.float32)[:] = 1

    return measured(fill)[0]


def cost_of_images(images: Path) -> Cost:
    """Return the cost of reading and developing the images."""
    from calibration.radiance import linear_images

    source = read_source(images)
    return measured(lambda: sum(len(image) for image in linear_images(source)))[0]


def cost_of_command(images: Path, out: Path, options: list[str]) -> Cost:
    """Return the cost of the command as users run it, with its start; the peak is that of all."""
    words = ["calibrate", "spheres", str(images), *options]
    # `alone` returns every freed block at once, which makes the command touch its memory again, and
    # limits BLAS to one thread. Users have neither, and compiled modules.
    ours = ("MALLOC_MMAP_THRESHOLD_", "OPENBLAS_NUM_THREADS", "PYTHONDONTWRITEBYTECODE")
    environment = {k: v for k, v in os.environ.items() if k not in ours}
    begun = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-m", "sgp", *words, "--out", str(out)], env=environment
    )
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(os.waitstatus_to_exitcode(status))
    wall = time.perf_counter() - begun
    return Cost(usage.ru_utime + usage.ru_stime, wall, 1024.0 * usage.ru_maxrss)


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--lights", type=int, default=36)
    parser.add_argument("--rendered", type=int, default=9)
    parser.add_argument("--png", action="store_true", help="PNGs instead of TIFFs")
    parser.add_argument("--chrome", action="store_true", help="12 JPEGs of one large ball")
    parser.add_argument("--folder", type=Path, help="keep the images; default: a temporary folder")
    options = parser.parse_args()
    if options.chrome and "SGP_DATA" not in os.environ:
        sys.exit("SGP_DATA is not set: it names the folder with uw/chrome")
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        images, out = folder / "images", Path(temporary) / "lights.json"
        if options.chrome:
            alone(write_chrome, images)
            costs = {"bytes": alone(cost_of_bytes, images), "images": alone(cost_of_images, images)}
            costs["command"] = cost_of_command(images, out, ["--gamma", "linear"])
            print_costs("12 JPEGs of 1280 x 850 px", costs)
            return
        suffix = ".png" if options.png else ".tif"
        rendered = min(options.rendered, options.lights)
        alone(write_recording, folder, options.lights, rendered, suffix)
        words = ["--camera", str(folder / "camera.json")]
        for radius in RADII_MM:
            words += ["--radius-mm", str(radius)]
        costs = {
            "bytes": alone(cost_of_bytes, images),
            "memory": alone(cost_of_memory, options.lights),
            "images": alone(cost_of_images, images),
            "command": cost_of_command(images, out, words),
        }
        found = read_lights(out).positions_mm
        true = read_lights(folder / "truth.json").positions_mm
    print_costs(f"{options.lights} images of {WIDTH} x {HEIGHT} px, {suffix}", costs)
    if found is not None and true is not None:
        shown = [shown_by(led, rendered) for led in range(len(found))]
        off = np.linalg.norm(found - true[shown], axis=1)
        print(f"mean error of the positions: {off.mean():.2f} mm")


def print_costs(title: str, costs: dict[str, Cost]) -> None:
    """Print a table of costs."""
    print(f"\n{title}\n{'':10}{'CPU s':>8}{'ratio':>8}{'peak MB':>10}")
    for name, cost in costs.items():
        ratio = cost.cpu_s / costs["images"].cpu_s
        print(f"{name:10}{cost.cpu_s:8.1f}{ratio:8.2f}{cost.peak_mb:10.0f}")


if __name__ == "__main__":
    main()
