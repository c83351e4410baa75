"""Variables of MAT-files by name."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final

from acquisition._errors import DataError, convert_read_errors
from acquisition._value_files.mat5 import mat5_names, read_mat5
from acquisition._values.lights import Array
from rig import MAX_BINARY_BYTES, UnreadableError, read_bounded

_MOST_NUMBERS: Final = 300_000


def variable_names(path: Path) -> list[str]:
    """Return the names of all variables of a MAT-file, numeric or not; errors as below."""
    with convert_read_errors(path):
        return mat5_names(read_bounded(path, MAX_BINARY_BYTES), 8 * _MOST_NUMBERS + 4096)


def read_variables(path: Path, names: Iterable[str]) -> dict[str, Array]:
    """Return those of the named numeric variables that a MAT-file has.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If the file is not a MAT-file of level 5, or is damaged.
    """
    found: dict[str, Array] = {}
    with convert_read_errors(path):
        data = read_bounded(path, MAX_BINARY_BYTES)
        for name in names:
            try:
                found[name] = read_mat5(data, name, _MOST_NUMBERS)
            except UnreadableError as error:
                if str(error) != f"no variable {name}":
                    raise
    for name, values in found.items():
        if values.ndim != 2:
            raise DataError(f"{path}: {name} is not a matrix, but has the shape {values.shape}")
    return found
