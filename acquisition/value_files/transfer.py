"""Files of measured transfer curves."""

from __future__ import annotations

import re
from pathlib import Path

from acquisition._errors import DataError, named
from acquisition.files.text_files import numbered_lines, read_text
from acquisition.values.transfer_curve import MOST_POINTS, TransferCurve

_SHOWN = 40


def read_transfer(path: str | Path) -> TransferCurve:
    r"""Read a transfer curve from a table in a text file.

    Parameters
    ----------
    path
        File with one point per line: sample and light, in any unit, separated by a comma, a
        semicolon or spaces; in files with semicolons, commas are decimal commas. Both columns begin
        with 0 and increase strictly; the last line belongs to the white level. A first line of
        words and lines that begin with ``#`` are skipped.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If it is not such a table; the message names the file and the line.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from acquisition.value_files import read_transfer
    >>> _ = Path("curve.csv").write_text("sample,light\n0,0\n128,0.2\n255,1\n")
    >>> read_transfer("curve.csv").light(np.array([0, 128 / 255, 1]))
    array([0. , 0.2, 1. ])
    """
    path = Path(path)
    points: list[tuple[float, float]] = []
    lines = [line for line in numbered_lines(read_text(path)) if not line[1].startswith("#")]
    between = r"\s*;\s*" if any(";" in line for _, line in lines) else r"\s*,\s*|\s+"
    for index, (number, line) in enumerate(lines):
        try:
            sample, light = (float(part.replace(",", ".")) for part in re.split(between, line))
        except ValueError:
            if index == 0 and re.search("[^\\W\\d_]", line):
                continue  # names of the columns
            raise DataError(
                f"{path} line {number}: {line[:_SHOWN]} is not a sample and its light: give two "
                "numbers"
            ) from None
        points.append((sample, light))
        if len(points) > MOST_POINTS:
            raise DataError(f"{path}: has more than {MOST_POINTS} points: give fewer")
    with named(path):
        return TransferCurve.table(points)
