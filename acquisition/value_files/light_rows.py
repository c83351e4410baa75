"""Rows of lights in text files of other programs: a name, a vector, and one further number."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path, PureWindowsPath
from typing import Final, NamedTuple

import numpy as np

from acquisition._errors import DataError
from acquisition.values.image_names import SUFFIXES
from rig.arrays import Float64

# The separator of a file is the first of these with which all its rows can be read. A comma is a
# decimal comma unless it is the separator.
_SPACE: Final = r"\s+"
_SEPARATORS: Final = (";", "\t", r",\s+", _SPACE, ",")
# Longer than a path and its numbers.
_LONGEST: Final = 5000
_QUOTES: Final = "\"'"
_NUMBER: Final = re.compile(
    r"[+-]?(?:[0-9]+(?:\.[0-9]*|,[0-9]+)?|\.[0-9]+)(?:e[+-]?[0-9]+)?|[+-]?(?:nan|inf(?:inity)?)",
    re.I,
)
# Names of columns: x, lx, light_x, x_mm, x (mm) and so on.
_AXIS: Final = re.compile(r"(?:.*[^a-z]|[dlnps])?([xyz])(?:[ _(\[]*[cm]?m[)\]]*)?")
_NAME_COLUMNS: Final = ("name", "file", "filename", "image")
_ID_COLUMNS: Final = ("id", "led", "light")
_INTENSITY_COLUMNS: Final = ("intensity", "strength", "brightness")


class LightRow(NamedTuple):
    """A row of a file of lights.

    Parameters
    ----------
    line
        Number of the line, from 1.
    text
        The line as it is.
    name
        Name of the image without its folder; empty without one.
    vector
        Three finite numbers.
    further
        The number after the vector; None without one.
    stated
        Whether the name of its column states that it is an intensity.
    unused
        Names of the columns that are not read.
    """

    line: int
    text: str
    name: str
    vector: tuple[float, ...]
    further: float | None = None
    stated: bool = False
    unused: tuple[str, ...] = ()


def light_rows(
    lines: Sequence[tuple[int, str]], path: Path, *, named: bool = False
) -> list[LightRow]:
    """Return the rows of a file of lights, with or without a first line that names its columns.

    Parameters
    ----------
    lines
        Number and text of each line, at least one.
    path
        File, for messages.
    named
        Whether every row must have a name.

    Raises
    ------
    DataError
        If a line is no such row, or if it cannot be known whether a number belongs to a name or
        follows a vector. The message names ``path`` and quotes the line.
    """
    form = "'file x y z'" if named else "three numbers"
    tried: list[_Row] = []
    refused: DataError | None = None
    for separator in _SEPARATORS:
        if columns := _columns(lines[0][1], separator):
            try:
                return _by_column([_Row(*line, separator, path) for line in lines], columns)
            except DataError as error:
                refused = refused or error
        rows: list[_Row] = []
        for line in lines:
            rows.append(_Row(*line, separator, path))
            if rows[-1].numbers < 3:
                break
        else:
            count = _numbers_per_row(rows, form, named=named)
            return [row.light(count) for row in rows]
        tried = max(tried, rows, key=len)
    if len(tried) == 1:
        form += " or a heading with x, y and z"
    raise refused or tried[-1].unlike(form, later=len(tried) > 1)


def is_comment(text: str) -> bool:
    """Return whether a line is a comment: no name of an image that begins with #, no heading."""
    is_row = _NUMBER.fullmatch(text.split()[-1])
    return text[0] in "#%" and not (is_row or any(_columns(text, each) for each in _SEPARATORS))


def same_length(vectors: Float64) -> bool:
    """Return whether vectors have one length, apart from 1 % and the rounding of their decimals."""
    exponents = [Decimal(repr(float(v))).normalize().as_tuple().exponent for v in vectors.ravel()]
    step = 10.0 ** min(0, *(each for each in exponents if isinstance(each, int)))
    with np.errstate(over="ignore", invalid="ignore"):  # numbers are checked later
        lengths = np.linalg.norm(vectors, axis=1)
        return bool(np.ptp(lengths) <= max(2 * step, 0.01 * lengths.max()))


class _Row:
    """A line, its fields, and the numbers at its end."""

    def __init__(self, line: int, text: str, separator: str, path: Path) -> None:
        self.line, self.text, self.path = line, text, path
        if len(text) > _LONGEST:
            raise DataError(f"{path} line {line}: {len(text)} characters: correct the line")
        self._spaced = separator == _SPACE
        self._body = text.rstrip(" \t;,")
        between = list(re.finditer(separator, self._body))
        self._starts = [0, *(match.end() for match in between)]
        ends = [*(match.start() for match in between), len(self._body)]
        spans = zip(self._starts, ends, strict=True)
        self.fields = [self._body[a:b].strip().strip(_QUOTES) for a, b in spans]
        words = (i for i, field in enumerate(reversed(self.fields)) if not _NUMBER.fullmatch(field))
        self.numbers = next(words, len(self.fields))

    def name(self, count: int) -> str:
        """Return what is before the last numbers, without a folder, which may be of Windows."""
        last = len(self.fields) - count
        # A number in a column before the name counts the rows.
        names = (i for i in range(last) if not (self._spaced or self.fields[i].isdecimal()))
        before = self._body[self._starts[next(names, 0)] : self._starts[last]]
        return PureWindowsPath(before.rstrip(" \t;,").strip(_QUOTES)).name

    def fits(self, count: int, *, named: bool) -> bool:
        """Return whether so many numbers may follow the name.

        A name is a whole number, or begins with another word. Words after that are of the name if
        they are whole numbers, follow no suffix of an image and are separated by white space.
        """
        begin, end = len(self.fields) - self.numbers, len(self.fields) - count
        if end < begin or (named and end == 0):
            return False
        inside = self.fields[begin:end]
        if begin == 0:
            return len(inside) <= 1 and all(map(str.isdecimal, inside))
        has_suffix = PureWindowsPath(self.fields[begin - 1]).suffix.lower() in SUFFIXES
        return not inside or (self._spaced and not has_suffix and all(map(str.isdecimal, inside)))

    def light(self, count: int) -> LightRow:
        """Return the row if so many numbers follow its name."""
        vector = self.vector(count)
        further = _value(self.fields[-1]) if count == 4 else None
        return self.checked(LightRow(self.line, self.text, self.name(count), vector, further))

    def vector(self, count: int) -> tuple[float, ...]:
        """Return the first three of the last numbers."""
        first = len(self.fields) - count
        return tuple(map(_value, self.fields[first : first + 3]))

    def checked(self, row: LightRow) -> LightRow:
        """Refuse numbers that are not finite."""
        if not all(map(math.isfinite, (*row.vector, row.further or 0.0))):
            raise DataError(
                f"{self.path} line {self.line}: a number is not finite: remove that light or "
                "measure it"
            )
        return row

    def unlike(self, form: str, *, later: bool = False) -> DataError:
        """Return the error that the line is no row, or not one like those before it."""
        as_before = ", as the lines before it are" if later else ""
        return DataError(
            f"{self.path} line {self.line}: '{self.text[:60]}' is not {form}{as_before}: correct "
            "the line"
        )


def _value(text: str) -> float:
    return float(text.replace(",", "."))


def _columns(text: str, separator: str) -> list[str]:
    """Return the names of columns in a line, with ``x``, ``y`` and ``z``; none if it has others."""
    names = _Row(0, text[:_LONGEST].lstrip("#% "), separator, Path()).fields
    names = [match[1] if (match := _AXIS.fullmatch(n)) else n for n in map(str.casefold, names)]
    return names if all(names.count(axis) == 1 for axis in "xyz") else []


def _by_column(rows: Sequence[_Row], columns: Sequence[str]) -> list[LightRow]:
    """Return the rows after a line that names their columns."""
    if len(rows) == 1:
        raise rows[0].unlike("followed by lights")
    for row in rows[1:]:
        if len(row.fields) != len(columns):
            raise row.unlike(f"a row with {len(columns)} columns")
    names = _name_column(rows, columns)
    strength = next((columns.index(name) for name in _INTENSITY_COLUMNS if name in columns), None)
    places = [columns.index(axis) for axis in "xyz"]
    if strength is not None:
        places.append(strength)
    used = {names, *places}
    unused = tuple(name for i, name in enumerate(columns) if name and i not in used)
    found = []
    for row in rows[1:]:
        texts = [row.fields[place] for place in places]
        if not all(map(_NUMBER.fullmatch, texts)):
            raise row.unlike("a row with numbers in these columns")
        x, y, z, *further = map(_value, texts)
        name = "" if names is None else PureWindowsPath(row.fields[names]).name
        value = further[0] if further else None
        light = LightRow(row.line, row.text, name, (x, y, z), value, stated=True, unused=unused)
        found.append(row.checked(light))
    return found


def _name_column(rows: Sequence[_Row], columns: Sequence[str]) -> int | None:
    """Return the column of names: one of a known name, the only one of differing words, or ids."""
    for name in _NAME_COLUMNS:
        if name in columns:
            return columns.index(name)
    words = [
        place
        for place, values in enumerate(zip(*(row.fields for row in rows[1:]), strict=True))
        if len(set(values)) == len(values) and not any(map(_NUMBER.fullmatch, values))
    ]
    if len(words) > 1:
        raise DataError(
            f"{rows[0].path} line {rows[0].line}: '{rows[0].text[:60]}' has several columns that "
            "may be the names of images: call the right one 'name'"
        )
    ids = [columns.index(name) for name in _ID_COLUMNS if name in columns]
    return next(iter(words + ids), None)


def _numbers_per_row(rows: Sequence[_Row], form: str, *, named: bool) -> int:
    """Return how many numbers follow the name of each row: 3, or 4.

    If both are possible, names that differ decide, or else vectors of one length.
    """
    fits = {count: [row.fits(count, named=named) for row in rows] for count in (3, 4)}
    counts = [count for count, each in fits.items() if all(each)]
    if not counts:
        wrong, count = max((each.index(False), -count) for count, each in fits.items())
        form += " and a number" if count == -4 else ""
        raise rows[wrong].unlike(form, later=wrong > 0)
    for decides in (
        lambda count: same_length(np.array([row.vector(count) for row in rows])),
        lambda count: len({row.name(count) for row in rows}) == len(rows),
    ):
        if len(counts) > 1:
            counts = list(filter(decides, counts)) or counts
    if len(counts) > 1:
        raise DataError(
            f"{rows[0].path} line {rows[0].line}: '{rows[0].text[:60]}' has a number that may "
            "belong to the name or follow the vector: put a line that names the columns before it"
        )
    return counts[0]
