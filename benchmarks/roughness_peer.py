"""Compare parameters of areas and profiles with those of SurfaceTopography, in its own process.

Give the Python of an environment that has SurfaceTopography:

    python benchmarks/roughness_peer.py --peer peer/bin/python --out rows.csv
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from changed_objects import PIXEL_MM, object_named

from processing.roughness import areal_parameters, fit_form

SIZE = 400
PEER = """
import json, sys
import numpy as np
from SurfaceTopography import Topography
heights, pixel = np.load(sys.argv[1]), float(sys.argv[2])
# Its first axis is x.
surface = Topography(heights.T, tuple(pixel * n for n in heights.T.shape), unit="mm")
plane = surface.detrend("center")
print(json.dumps({
    "Sq": 1000 * plane.rms_height_from_area(),
    "Sdq": plane.rms_gradient(),
    "Sa": 1000 * float(np.abs(plane.heights()).mean()),
}))
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--peer", type=Path, required=True)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows = []
    for name in ("coin", "leather", "textile", "woodcarving", "print", "plaster"):
        surface, _ = object_named(name, 40)
        at = (np.arange(SIZE) - SIZE / 2 + 0.5) * PIXEL_MM * 0.6
        heights = surface.evaluate(*np.meshgrid(at, -at))[0]
        heights = heights - fit_form(heights, PIXEL_MM, "plane").heights
        with TemporaryDirectory() as folder:
            file = Path(folder) / "heights.npy"
            np.save(file, heights)
            words = [options.peer, "-c", PEER, file, str(0.6 * PIXEL_MM)]
            done = subprocess.run(words, capture_output=True, text=True, check=True)
        theirs = json.loads(done.stdout.splitlines()[-1])
        ours = areal_parameters(heights, 0.6 * PIXEL_MM)
        for key, value in theirs.items():
            rows.append(
                (name, key, f"{ours[key]:.6g}", f"{value:.6g}", f"{ours[key] / value - 1:+.3%}")
            )
            print(*rows[-1])
    if options.out:
        with options.out.open("w", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(("surface", "parameter", "ours", "SurfaceTopography", "difference"))
            table.writerows(rows)


if __name__ == "__main__":
    main()
