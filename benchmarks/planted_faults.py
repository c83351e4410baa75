"""Faults that are planted in a correct recording of a real object, and what the check names.

The cat of DiLiGenT under 96 lights, in the folder that SGP_DATA names. In each draw the images of
two lights are swapped, or one image is 10 % brighter or darker. "named" counts draws whose notices
name all images at fault, "others" the images that are named although they are correct.

    SGP_DATA=data python benchmarks/planted_faults.py --seed 201
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from harness import command_line

from acquisition import read_source
from calibration import linear_stack
from processing.checks import image_quality


def main() -> None:
    """Print one line for each draw, and the counts."""
    parser = command_line(__doc__)
    parser.add_argument("--seed", type=int, default=201, help="seed of the draws")
    parser.add_argument("--draws", type=int, default=8, help="number of draws of each fault")
    parser.add_argument("--object", default="catPNG", help="folder of the object")
    options = parser.parse_args()
    if "SGP_DATA" not in os.environ:
        raise SystemExit("SGP_DATA is not set: it names the folder of the data")
    source = read_source(Path(os.environ["SGP_DATA"]) / "diligent" / options.object)
    stack, mask = linear_stack(source), source.mask
    if stack.lights is None or mask is None:
        raise SystemExit(f"{source.path} has no lights or no mask")
    rng = np.random.default_rng(options.seed)
    named, others = {"swapped": 0, "10 %": 0}, {"swapped": 0, "10 %": 0}
    for draw in range(options.draws):
        for fault in named:
            first, second = rng.choice(len(stack.ids), 2, replace=False)
            values, at_fault = stack.values.copy(), {stack.ids[first]}
            if fault == "swapped":
                values[[first, second]] = values[[second, first]]
                at_fault.add(stack.ids[second])
            else:
                values[first] *= 1.1 if draw % 2 == 0 else 0.9
            notices = image_quality(values, stack.lights, mask).warnings
            found = {name for notice in notices for name in notice.where.split(", ") if name}
            named[fault] += at_fault <= found
            others[fault] += len(found - at_fault)
            print(
                f"{fault:8} {sorted(at_fault)}: {[str(notice) for notice in notices]}", flush=True
            )
    for fault, count in named.items():
        print(f"{fault:8} named {count} of {options.draws}, others {others[fault]}")


if __name__ == "__main__":
    main()
