"""Which sphere of which recording the options --mask and --sphere mark."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from sgp.cli.exit import UsageError
from sgp.cli.options import numbers

_NUMBERED = re.compile(r"([0-9]+):(.+)", re.DOTALL)


@dataclass
class Marks:
    """What marks the spheres of one recording: mask files, and circles x, y, radius in pixels."""

    masks: list[Path] = field(default_factory=list)
    circles: list[tuple[float, float, float]] = field(default_factory=list)


def marks_of(mask: Sequence[str], sphere: Sequence[str], recordings: int) -> list[Marks]:
    """Return the marks of each recording.

    With one recording, the options are as they are; with several, each starts with the number of
    its recording, from 1, and a colon.

    Raises
    ------
    UsageError
        If the number is missing or there is no such recording, a circle is not three numbers, or
        a recording has both masks and circles.
    """
    marks = [Marks() for _ in range(recordings)]
    for text in mask:
        k, value = _split("--mask", text, recordings, "ball.png")
        marks[k].masks.append(Path(value))
    for text in sphere:
        k, value = _split("--sphere", text, recordings, "810,395,120")
        x, y, radius = numbers("--sphere", value, 3)
        marks[k].circles.append((x, y, radius))
    for k, mark in enumerate(marks):
        if mark.masks and mark.circles:
            where = "" if recordings == 1 else f" of recording {k + 1}"
            raise UsageError(
                f"--mask and --sphere both give the outlines of the spheres{where}: give only one"
            )
    return marks


def _split(option: str, text: str, recordings: int, example: str) -> tuple[int, str]:
    """Return the index of the recording of a mark, and the mark."""
    if recordings == 1:
        return 0, text
    numbered = _NUMBERED.fullmatch(text)
    if numbered is None:
        raise UsageError(
            f"{option} {text}: which of the {recordings} recordings shows this sphere? Start with "
            f"its number and a colon, for example {option} 2:{example}"
        )
    number = int(numbered[1])
    if not 1 <= number <= recordings:
        raise UsageError(
            f"{option} {text}: there is no recording {number}: give a number from 1 to {recordings}"
        )
    return number - 1, numbered[2]
