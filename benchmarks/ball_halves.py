"""Directions from a real chrome ball, with outlines fitted to different halves of the images.

The ball is that of the University of Washington ($SGP_DATA/uw/chrome): 12 images, no plane under
it. Each half of the images determines an outline; the highlights of all images, seen in it, give
directions. The columns are the mean angle between the directions of both outlines, their difference
in centre x, centre y and radius, and the mean of the stated errors of both.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
from harness import command_line

from acquisition import Lights, angle_deg, read_source
from calibration import EstimateError, calibrate_spheres, linear_stack
from calibration.spheres import orthographic_directions

IMAGES = 12
INDEX = np.arange(IMAGES)
HALVES = {
    "even, odd": INDEX % 2 == 0,
    "first, second": INDEX < IMAGES // 2,
    "pairs": (INDEX // 2) % 2 == 0,
    "triples": (INDEX // 3) % 2 == 0,
    "1 4 5 8 9 12, others": np.isin(INDEX % 4, (0, 3)),
    "outer, inner": (INDEX < 3) | (INDEX >= 9),
}


def stated_deg(lights: Lights) -> float:
    """Return the root mean square of the stated errors of directions in degrees."""
    if lights.errors is None or lights.errors.covariances is None:
        return float("nan")
    variances = np.trace(lights.errors.covariances, axis1=1, axis2=2)
    return float(np.degrees(np.sqrt(np.mean(variances))))


def main() -> None:
    parser = command_line(__doc__)
    parser.parse_args()
    data = os.environ.get("SGP_DATA")
    if not data:
        sys.exit("SGP_DATA is not set: it names the folder with uw/chrome")
    values = linear_stack(read_source(Path(data) / "uw" / "chrome")).values
    highlights_px = calibrate_spheres(values).highlights_px[:, 0]
    print(f"{'halves':24}  apart    x      y      radius px   stated")
    means = []
    for name, half in HALVES.items():
        try:
            parts = [calibrate_spheres(values[half]), calibrate_spheres(values[~half])]
        except EstimateError as refusal:
            print(f"{name:24} refused: {refusal}")
            continue
        a, b = (part.spheres[0].outline for part in parts)
        directions = [orthographic_directions(outline, highlights_px) for outline in (a, b)]
        apart = angle_deg(*directions).mean()
        means.append(apart)
        errors = [stated_deg(part.lights) for part in parts]
        x, y = np.subtract(b.centre_px, a.centre_px)
        print(
            f"{name:24} {apart:6.3f} {x:6.2f} {y:6.2f} {b.radius_px - a.radius_px:6.2f}"
            f"      {np.mean(errors):6.3f} deg"
        )
    print(f"{'mean':24} {np.mean(means) if means else np.nan:6.3f} deg")


if __name__ == "__main__":
    main()
