"""Lights as text: .lp files of RTI, and tables with three numbers per line as in DiLiGenT."""

from __future__ import annotations

import math
from pathlib import Path, PureWindowsPath

import numpy as np

from acquisition._errors import DataError
from acquisition._text_files import numbered_lines, read_text
from acquisition._values.lights import Array, Lights
from rig import pluralize

DIRECTIONS_FILE = "light_directions.txt"
INTENSITIES_FILE = "light_intensities.txt"
FILENAMES_FILE = "filenames.txt"
_MOST_LIGHTS = 100_000


def parse_lp(text: str, path: Path) -> Lights:
    """Build lights from the text of an .lp file: the count, then one line ``file x y z`` per light.

    File names may contain spaces and Windows folders, which are dropped from the ids. Numbers may
    have a decimal comma, and vectors may have any length.

    Raises
    ------
    DataError
        If the count or a row is invalid; the message names ``path`` and the line.
    """
    lines = _rows(text, path)
    if not lines:
        raise DataError(
            f"{path}: an empty file: the first line of an .lp file must be the number of lights"
        )
    first, count = lines[0]
    if not (count.isascii() and count.isdecimal()):
        raise DataError(
            f"{path} line {first}: '{count[:40]}' is not a count: the first line of an .lp file "
            "must be the number of lights"
        )
    if count.lstrip("0") != str(len(lines) - 1):
        raise DataError(
            f"{path} line {first}: the count is {count[:40]}, but "
            f"{pluralize(len(lines) - 1, 'light follows', 'lights follow')}: correct the count or "
            "the rows"
        )
    names: dict[str, None] = {}
    vectors = []
    for number, line in lines[1:]:
        parts = line.rsplit(maxsplit=3)
        if len(parts) != 4:
            raise DataError(
                f"{path} line {number}: '{line[:40]}' is not 'file x y z': correct the line"
            )
        name = PureWindowsPath(parts[0]).name
        if name in names:
            raise DataError(f"{path} line {number}: {name} is listed twice: remove one line")
        names[name] = None
        vectors.append(_numbers([part.replace(",", ".") for part in parts[1:]], path, number))
        _refuse_zero(vectors[-1], path, number)
    return Lights(directions=np.array(vectors), ids=tuple(names))


def lp_text(lights: Lights) -> str:
    """Return the text of an .lp file with ids and unit directions."""
    rows = [
        f"{light} {x:.9f} {y:.9f} {z:.9f}\n"
        for light, (x, y, z) in zip(lights.ids, lights.unit_directions, strict=True)
    ]
    return f"{len(lights)}\n{''.join(rows)}"


def parse_directions(text: str, path: Path) -> Lights:
    """Build lights from N rows of three numbers, with or without a leading count.

    A file named light_directions.txt is read as DiLiGenT's: light_intensities.txt and filenames.txt
    in the same folder add intensities and ids.

    Raises
    ------
    DataError
        If a row is not a vector, or the files have different counts; the message names file and
        line.
    """
    rows = _table(text, path)
    for number, vector in rows:
        _refuse_zero(vector, path, number)
    ids: tuple[str, ...] = ()
    intensities: Array | None = None
    if path.name == DIRECTIONS_FILE:
        names, strengths = path.with_name(FILENAMES_FILE), path.with_name(INTENSITIES_FILE)
        if names.exists():
            ids = tuple(name for _, name in numbered_lines(read_text(names)))
            _same_count(path, len(rows), names, len(ids))
        if strengths.exists():
            intensities = _intensities(strengths)
            _same_count(path, len(rows), strengths, len(intensities))
    return Lights(
        directions=np.array([vector for _, vector in rows]), intensities=intensities, ids=ids
    )


def _intensities(path: Path) -> Array:
    rows = _table(read_text(path), path)
    for number, values in rows:
        if min(values) <= 0:
            raise DataError(
                f"{path} line {number}: an intensity that is not positive: remove that light"
            )
    return np.array([values for _, values in rows])


def _table(text: str, path: Path) -> list[tuple[int, list[float]]]:
    lines = _rows(text, path)
    if lines and lines[0][1] == str(len(lines) - 1):
        lines = lines[1:]
    if not lines:
        raise DataError(f"{path}: an empty file: give three numbers per line")
    # In a line with points, commas are separators; in other lines they are decimal commas.
    return [
        (number, _numbers(line.replace(",", " " if "." in line else ".").split(), path, number))
        for number, line in lines
    ]


def _rows(text: str, path: Path) -> list[tuple[int, str]]:
    lines = numbered_lines(text)
    if len(lines) > _MOST_LIGHTS + 1:
        raise DataError(f"{path}: {len(lines)} lines: at most {_MOST_LIGHTS} lights are allowed")
    return lines


def _numbers(parts: list[str], path: Path, number: int) -> list[float]:
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    if len(values) != 3:
        raise DataError(
            f"{path} line {number}: '{' '.join(parts)[:40]}' is not three numbers: correct the line"
        )
    if not all(map(math.isfinite, values)):
        raise DataError(
            f"{path} line {number}: a number is not finite: remove that light or measure it"
        )
    return values


def _refuse_zero(vector: list[float], path: Path, number: int) -> None:
    if math.hypot(*vector) < 1e-9:
        raise DataError(
            f"{path} line {number}: a zero vector is not a direction: remove that light"
        )


def _same_count(path: Path, count: int, other: Path, other_count: int) -> None:
    if count != other_count:
        raise DataError(
            f"{path}: {count} lights, but {other.name} in the same folder has {other_count}: give "
            "both one line per light"
        )
