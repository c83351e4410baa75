"""DNG files with stated mosaics, levels, tables and areas (needs tifffile)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from rig.arrays import AnyArray, Floating

_CODE = {"R": 0, "G": 1, "B": 2}
_LINEAR_RAW = 34892


def white(*levels: int) -> tuple[Any, ...]:
    """Return the tag WhiteLevel."""
    return (50717, "I", len(levels), levels, True)


def black(levels: Any) -> list[tuple[Any, ...]]:
    """Return the tags BlackLevel and BlackLevelRepeatDim of one level or of a table."""
    table = np.atleast_2d(levels)
    parts = tuple(int(q) for value in table.ravel() for q in (round(value * 100), 100))
    return [(50714, "2I", table.size, parts, True), (50713, "H", 2, table.shape, True)]


def delta(levels: Floating, *, rows: bool) -> tuple[Any, ...]:
    """Return the tag BlackLevelDeltaV (one value per row) or BlackLevelDeltaH."""
    parts = tuple(int(q) for value in levels for q in (round(value * 100), 100))
    return (50716 if rows else 50715, "2i", len(levels), parts, True)


def area(top: int, left: int, bottom: int, right: int) -> tuple[Any, ...]:
    """Return the tag ActiveArea."""
    return (50829, "I", 4, (top, left, bottom, right), True)


def write_dng(
    path: Path,
    data: AnyArray,
    *,
    pattern: str | None = "RGGB",
    extra: Sequence[tuple[Any, ...]] = (),
    thumbnail: bool = False,
    **options: Any,
) -> None:
    """Write a DNG file; ``pattern`` None for a camera without a colour filter.

    With ``thumbnail``, the mosaic is in a directory below that of a small image.
    """
    camera = [
        (50706, "B", 4, b"\1\4\0\0", True),
        (50708, "s", 0, "Test Cam", True),
        (271, "s", 0, "Test", True),
        (272, "s", 0, "Cam", True),
        (50721, "2i", 9, tuple(q for i in range(9) for q in (int(i % 4 == 0), 1)), True),
        (50728, "2I", 3, (1, 1, 1, 1, 1, 1), True),
        (50778, "H", 1, 21, True),
        (274, "H", 1, 1, True),
        (33434, "2I", 1, (1, 60), True),
        (34855, "H", 1, 100, True),
    ]
    tags: list[tuple[Any, ...]] = []
    if pattern is not None:
        side = round(len(pattern) ** 0.5)
        tags = [
            (33421, "H", 2, (side, side), True),
            (33422, "B", len(pattern), bytes(_CODE[letter] for letter in pattern), True),
            (50711, "H", 1, 1, True),
        ]
    form = {"metadata": None, "photometric": "minisblack" if pattern is None else "cfa", **options}
    with tifffile.TiffWriter(path, byteorder=form.pop("byteorder", "<")) as file:
        if thumbnail:
            small = np.zeros((12, 16, 3), np.uint8)
            file.write(
                small,
                photometric="rgb",
                subfiletype=1,
                subifds=1,
                extratags=camera,
                metadata=None,
            )
            file.write(data, subfiletype=0, extratags=[*tags, *extra], **form)
        else:
            file.write(data, subfiletype=0, extratags=[*camera, *tags, *extra], **form)
    if pattern is None and data.ndim == 2:
        with tifffile.TiffFile(path, mode="r+b") as file:
            page = file.pages[0].pages[0] if thumbnail else file.pages[0]
            page.tags[262].overwrite(_LINEAR_RAW)
