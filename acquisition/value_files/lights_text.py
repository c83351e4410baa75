"""Lights as text: .lp files of RTI, and tables with three numbers per line as in DiLiGenT."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from acquisition._errors import DataError
from acquisition.files.text_files import numbered_lines, read_text
from acquisition.value_files.light_rows import LightRow, is_comment, light_rows, same_length
from acquisition.values.lights import Lights
from rig import Notice, pluralize
from rig.arrays import Float64

DIRECTIONS_FILE = "light_directions.txt"
INTENSITIES_FILE = "light_intensities.txt"
FILENAMES_FILE = "filenames.txt"
_MOST_LIGHTS = 100_000
# Numbers that differ by less than this share are the same.
_SAME = 0.01
# Lights of one rig differ in intensity by less than this factor from their mean.
_UNLIKE = 2.0
# Vectors of one length are directions unless it is that of a rig in mm.
_SHORTEST_MM = 20.0


def parse_lp(text: str, path: Path) -> Lights:
    """Build lights from the text of an .lp file: the count, then one line ``file x y z`` per light.

    File names may contain spaces and Windows folders, which are dropped from the ids. Fields are
    separated by semicolons, tabs, white space or commas, the first of these that fits all lines;
    commas are decimal commas otherwise. Lines that begin with # or % are comments, unless they are
    such a row or name the columns. A fourth number is the intensity of the light if it varies
    near 1. Vectors may have any length: a notice says so if it may have a meaning.

    Raises
    ------
    DataError
        If the count or a row is invalid; the message names ``path`` and the line.
    """
    lines = _lines(text, path)
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
    rows = light_rows(lines[1:], path, named=True) if len(lines) > 1 else []
    if not rows or count.lstrip("0") != str(len(rows)):
        raise DataError(
            f"{path} line {first}: the count is {count[:40]}, but "
            f"{pluralize(len(rows), 'light follows', 'lights follow')}: correct the count or "
            "the rows"
        )
    return _lights(rows, path)


def lp_text(lights: Lights) -> str:
    """Return the text of an .lp file with ids and unit directions."""
    rows = [
        f"{light} {x:.9f} {y:.9f} {z:.9f}\n"
        for light, (x, y, z) in zip(lights.ids, lights.unit_directions, strict=True)
    ]
    return f"{len(lights)}\n{''.join(rows)}"


def parse_directions(text: str, path: Path) -> Lights:
    """Build lights from N rows of three numbers, with or without a leading count.

    Names before the numbers, and a fourth number, are read as in an .lp file. A first line may name
    the columns (``name,x,y,z``). A file named light_directions.txt is read as DiLiGenT's:
    light_intensities.txt and filenames.txt in the same folder add intensities and ids.

    Raises
    ------
    DataError
        If a row is not a vector, or the files have different counts; the message names file and
        line.
    """
    lights = _lights(_table(text, path), path)
    if path.name == DIRECTIONS_FILE:
        names, strengths = path.with_name(FILENAMES_FILE), path.with_name(INTENSITIES_FILE)
        if names.exists():
            ids = tuple(name for _, name in numbered_lines(read_text(names)))
            _same_count(path, len(lights), names, len(ids))
            lights = replace(lights, ids=ids)
        if strengths.exists():
            intensities = _intensities(strengths)
            _same_count(path, len(lights), strengths, len(intensities))
            lights = replace(lights, intensities=intensities)
    return lights


def _lights(rows: Sequence[LightRow], path: Path) -> Lights:
    """Build lights from rows, with a notice for what the file leaves open."""
    names: dict[str, None] = {}
    any_name = any(row.name for row in rows)
    for row in rows:
        if math.hypot(*row.vector) < 1e-9:
            raise DataError(
                f"{path} line {row.line}: a zero vector is not a direction: remove that light"
            )
        if any_name and not row.name:
            raise DataError(f"{path} line {row.line}: '{row.text[:60]}' has no name: add it")
        if any_name and row.name in names:
            raise DataError(f"{path} line {row.line}: {row.name} is listed twice: remove one line")
        names[row.name] = None
    vectors = np.array([row.vector for row in rows])
    lights = Lights(directions=vectors, ids=tuple(names) if any_name else ())
    lengths = np.linalg.norm(vectors, axis=1)
    intensities, warnings = _further(rows, lengths, path)
    if not same_length(vectors) or lengths.max() > _SHORTEST_MM:
        text = (
            f"the vectors are {_span(lengths)} long: lengths are not used, the lights count as "
            "distant; if these are positions in mm, give them as position_mm in lights.json"
        )
        warnings += (Notice("light-lengths-unused", text, str(path)),)
    if unused := rows[0].unused:
        what = pluralize(len(unused), "column of the list is", "columns of the list are")
        text = f"{what} not used: {', '.join(unused)}"
        warnings += (Notice("light-column-assumed", text, str(path), "info"),)
    return replace(lights, intensities=intensities, warnings=warnings)


def _further(
    rows: Sequence[LightRow], lengths: Float64, path: Path
) -> tuple[Float64 | None, tuple[Notice, ...]]:
    """Return the numbers after the vectors as intensities if they are that, and the notice."""
    values = np.array([row.further for row in rows if row.further is not None])
    if not len(values):
        return None, ()
    low, high = values.min(), values.max()
    stated = rows[0].stated
    if not stated and (high - low <= _SAME * abs(high) or np.allclose(values, lengths, _SAME)):
        text = f"the number after each vector ({_span(values)}) is not used"
        return None, (Notice("light-column-assumed", text, str(path), "info"),)
    for row, value in zip(rows, values, strict=True):
        if value <= 0 or not (stated or 1 / _UNLIKE < value < _UNLIKE):
            raise DataError(
                f"{path} line {row.line}: '{row.text[:60]}' has the number {value:g} after the "
                "vector, which is not an intensity near 1: remove these numbers, or put a line "
                "'name x y z intensity' before the lights"
            )
    text = f"the number after each vector ({_span(values)}) is used as intensity"
    notice = Notice("light-column-assumed", text, str(path))
    return values, () if stated else (notice,)


def _span(values: Float64) -> str:
    low, high = f"{values.min():.4g}", f"{values.max():.4g}"
    return low if low == high else f"{low} to {high}"


def _intensities(path: Path) -> Float64:
    rows = _table(read_text(path), path)
    for row in rows:
        if min(row.vector) <= 0:
            raise DataError(
                f"{path} line {row.line}: an intensity that is not positive: remove that light"
            )
    return np.array([row.vector for row in rows])


def _table(text: str, path: Path) -> list[LightRow]:
    lines = _lines(text, path)
    if lines and lines[0][1] == str(len(lines) - 1):
        lines = lines[1:]
    rows = light_rows(lines, path) if lines else []
    if not rows:
        raise DataError(f"{path}: an empty file: give three numbers per line")
    return rows


def _lines(text: str, path: Path) -> list[tuple[int, str]]:
    # Spreadsheets write rows of separators after the last one.
    lines = [line for line in numbered_lines(text) if line[1].strip(" \t;,")]
    lines = [line for line in lines if not is_comment(line[1])]
    if len(lines) > _MOST_LIGHTS + 1:
        raise DataError(f"{path}: {len(lines)} lines: at most {_MOST_LIGHTS} lights are allowed")
    return lines


def _same_count(path: Path, count: int, other: Path, other_count: int) -> None:
    if count != other_count:
        raise DataError(
            f"{path}: {count} lights, but {other.name} in the same folder has {other_count}: give "
            "both one line per light"
        )
