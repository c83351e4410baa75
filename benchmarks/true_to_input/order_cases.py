"""Which image belongs to which light: names of files, and rows of lists."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from true_to_input.case import Case, Outcome, judge
from true_to_input.relief import MASK, directions, error_of, images


def _wrapped(folder: Path, count: int) -> Outcome:
    source = folder / "src"
    source.mkdir()
    lights, turn = directions(count), count // 2
    numbers = [9999 - turn + 1 + i if i < turn else i - turn + 1 for i in range(count)]
    for number, image in zip(numbers, images(lights), strict=True):
        cv2.imwrite(
            str(source / f"IMG_{number:04d}.png"), np.round(image * 65535).astype(np.uint16)
        )
    cv2.imwrite(str(source / "mask.png"), MASK)
    np.savetxt(folder / "lights.txt", lights, fmt="%.6f")
    answer, error = error_of(source, "--lights", folder / "lights.txt")
    return judge(answer, error)


CASES = tuple(
    Case(f"wrap{n}", 1, "order 9999, 0001 kept", lambda folder, n=n: _wrapped(folder, n))
    for n in (4, 5, 6, 8)
)
