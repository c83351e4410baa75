"""Read a normal map that a user gives, and judge its axes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import processing
import rig
from sgp._hashes import input_hashes

Green = Literal["up", "down"]


def read_map(
    path: Path, *, green: Green = "up", option: str | None = "--green", max_pixels: int
) -> processing.NormalMapFile:
    """Read a normal map; its notices name it if it is a surface only with other axes.

    If z is in another channel than blue, that is named, and the axes are not judged.

    Parameters
    ----------
    path
        Image of normals, or folder with normals.* and mask.png.
    green
        Direction of the green channel.
    option
        The option that states it, None if the command has none.
    max_pixels
        Largest allowed number of pixels.
    """
    read = processing.read_normals(path, green=green, max_pixels=max_pixels)
    input_hashes(read.files)
    named = with_doubts(read.warnings, path, read.normal_map, green, option)
    return read._replace(warnings=named)


def with_doubts(
    notices: tuple[rig.Notice, ...],
    path: Path,
    given: processing.NormalRows,
    green: Green = "up",
    option: str | None = "--green",
) -> tuple[rig.Notice, ...]:
    """Return the notices of a reader with those about the axes, unless it has named the axes."""
    if any(notice.code == "normals-channels-swapped" for notice in notices):
        return notices
    doubts = processing.axes_notices(given)
    named = [replace(with_remedy(doubt, green, option), where=str(path)) for doubt in doubts]
    return (*notices, *named)


def with_remedy(notice: rig.Notice, green: Green, option: str | None = "--green") -> rig.Notice:
    """Name the option that inverts green, if it may help."""
    if notice.code != "normals-mirrored" or option is None:
        return notice
    other = "down" if green == "up" else "up"
    return replace(notice, text=f"{notice.text}; if green is the other way round, {option} {other}")
