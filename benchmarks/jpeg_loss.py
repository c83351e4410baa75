"""What the compression of JPEG costs: angles between normals from images and from their JPEGs.

The captures `buddha`, `cat` and `gray` of the University of Washington (folder `uw` of SGP_DATA,
lights from `chrome`) are saved with the sRGB curve as JPEGs of several qualities, with colours at
full resolution (444) and at half of it (420), and read as photographs are, by `sgp normals`. The
angles to the normals of the linear 8-bit images are means over the pixels that both have, in
degrees; docs/photographs.md states their range.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from harness import command_line

from acquisition import SRGB, angle_deg, read_image
from processing import NormalMap, read_normals

SAMPLING = {
    "444": cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
    "420": cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420,
}


def sgp(*words: str | Path) -> None:
    subprocess.run([sys.executable, "-m", "sgp", *map(str, words)], check=True, capture_output=True)


def save_jpegs(source: Path, folder: Path, quality: int, sampling: str) -> None:
    """Save the images of a capture with the sRGB curve, and its mask as it is."""
    folder.mkdir()
    options = [
        cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, SAMPLING[sampling],
    ]  # fmt: skip
    for path in source.glob(f"{source.name}.*.tga"):
        pixels = read_image(path)
        if path.stem.endswith("mask"):
            cv2.imwrite(str(folder / "mask.png"), pixels)
        else:
            samples = np.rint(255 * SRGB.samples(pixels / 255)).astype(np.uint8)
            cv2.imwrite(str(folder / f"{path.stem}.jpg"), samples[..., ::-1], options)


def normals(source: Path, lights: Path, out: Path) -> NormalMap:
    sgp("normals", source, "--lights", lights, "--out", out)
    return read_normals(out).normal_map


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--qualities", type=int, nargs="+", default=[100, 95, 90])
    options = parser.parse_args()
    if "SGP_DATA" not in os.environ:
        print("SGP_DATA is not set: nothing to measure")
        return
    data = Path(os.environ["SGP_DATA"]) / "uw"
    print("capture  quality  444   420")
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        lights = work / "lights.json"
        sgp("calibrate", "spheres", data / "chrome", "--out", lights)
        for capture in ("buddha", "cat", "gray"):
            linear = normals(data / capture, lights, work / capture)
            for quality in options.qualities:
                line = f"{capture:8} {quality:7}"
                for sampling in SAMPLING:
                    key = f"{capture}-{quality}-{sampling}"
                    save_jpegs(data / capture, work / f"{key}-jpeg", quality, sampling)
                    found = normals(work / f"{key}-jpeg", lights, work / key)
                    both = linear.mask & found.mask
                    angles = angle_deg(linear.normals[both], found.normals[both])
                    line += f"{angles.mean():6.2f}"
                print(line, flush=True)


if __name__ == "__main__":
    main()
