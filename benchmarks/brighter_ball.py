"""Highlights of a real ball that was exposed longer: do the lights move more than is stated?

The images of one ball without clipping below white are made two, four and eight times as bright in
linear light, clipped at white and calibrated again. Each line contains, for one brightness, the
angles between the lights and those of the original images, and the standard deviations along one
axis that are stated for them, in degrees; or the message of the refusal. Decision 30 has the
figures of the light probes of PSBox (https://github.com/yxiong/PSBox, data/LightProbe-1 and -2):

    python benchmarks/brighter_ball.py PSBox/data/LightProbe-2
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from harness import command_line

from acquisition import angle_deg, read_source
from calibration import EstimateError, calibrate_spheres, linear_stack


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("images", type=Path, help="folder with the images of one ball")
    options = parser.parse_args()
    stack = linear_stack(read_source(options.images))
    values = np.nan_to_num(np.asarray(stack.values), nan=1.0)
    first: dict[str, np.ndarray] = {}
    for times in (1, 2, 4, 8):
        brighter = np.where(times * values >= 1, np.nan, times * values).astype(np.float32)
        try:
            lights = calibrate_spheres(brighter).lights
        except EstimateError as refusal:
            print(f"{times} times: refused: {refusal}")
            continue
        directions = dict(zip(lights.ids, lights.unit_directions, strict=True))
        first = first or directions
        moved = [
            float(angle_deg(directions[one], first[one])) for one in directions if one in first
        ]
        variances = np.trace(lights.errors.covariances, axis1=1, axis2=2) / 2
        print(f"{times} times: moved  " + " ".join(f"{angle:5.2f}" for angle in moved))
        print("         stated " + " ".join(f"{x:5.2f}" for x in np.degrees(np.sqrt(variances))))


if __name__ == "__main__":
    main()
