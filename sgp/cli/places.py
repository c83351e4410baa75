"""Areas and lines of an image, as options name them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import acquisition
from processing.roughness import Line
from rig.arrays import Bool
from sgp.cli.exit import UsageError

_NAMED = re.compile(r"(?:([\w .-]{1,40})=)?(.+)")
_NUMBER = r"\s*[-+]?[0-9]{1,7}(?:\.[0-9]{1,6})?\s*"


@dataclass(frozen=True)
class Region:
    """A rectangle x, y, width, height in whole pixels, or a mask."""

    name: str
    rectangle: tuple[int, int, int, int] | None
    mask: Path | None

    def inside(self, size: tuple[int, int]) -> Bool:
        """Return ``(H, W)`` bool."""
        if self.mask is not None:
            return acquisition.read_mask(self.mask, size)
        if self.rectangle is None:
            return np.ones(size, np.bool_)
        x, y, width, height = self.rectangle
        if x < 0 or y < 0 or width < 1 or height < 1 or x + width > size[1] or y + height > size[0]:
            raise acquisition.DataError(
                f"region {self.name}: {x},{y},{width},{height} is not inside the image of "
                f"{size[1]} x {size[0]} pixels"
            )
        found = np.zeros(size, np.bool_)
        found[y : y + height, x : x + width] = True
        return found


def regions(texts: Iterable[str]) -> list[Region]:
    """Read ``[NAME=]X,Y,W,H`` and ``[NAME=]MASK`` of --region; the complete map without any.

    Raises
    ------
    UsageError
        If a text is neither, or a name is there twice.
    """
    found = []
    for text in texts:
        name, place = _parts(text)
        numbers = place.split(",")
        if len(numbers) == 4 and all(re.fullmatch(r"\s*-?[0-9]{1,7}\s*", one) for one in numbers):
            x, y, width, height = map(int, numbers)
            found.append(Region(name or place, (x, y, width, height), None))
        elif Path(place).is_file():
            found.append(Region(name or Path(place).stem, None, Path(place)))
        else:
            raise UsageError(
                f"--region {text}: is neither x,y,w,h in pixels, such as 100,80,640,480, nor the "
                "file of a mask"
            )
    _check_names([one.name for one in found], "--region")
    return found


def lines(texts: Iterable[str], option: str) -> list[tuple[str, Line]]:
    """Read ``[NAME=]X0,Y0,X1,Y1[,WIDTH]``.

    Raises
    ------
    UsageError
        If a text is something else, or a name is there twice.
    """
    found = []
    for text in texts:
        name, place = _parts(text)
        numbers = place.split(",")
        if len(numbers) not in (4, 5) or not all(re.fullmatch(_NUMBER, one) for one in numbers):
            raise UsageError(
                f"{option} {text}: give x0,y0,x1,y1 in pixels, such as 10,50,300,50, and perhaps a "
                "width"
            )
        width = float(numbers[4]) if len(numbers) == 5 else 1
        if width < 1 or width != int(width):
            raise UsageError(f"{option} {text}: the width is not a whole number of pixels from 1")
        x0, y0, x1, y1 = map(float, numbers[:4])
        found.append((name or place, Line(x0, y0, x1, y1, int(width))))
    _check_names([name for name, _ in found], option)
    return found


def _parts(text: str) -> tuple[str, str]:
    match = _NAMED.fullmatch(text)
    return ((match[1] or "").strip(), match[2]) if match else ("", text)


def _check_names(names: list[str], option: str) -> None:
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise UsageError(f"{option}: {twice} is given twice: give each a name, such as rim=...")
