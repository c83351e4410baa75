"""Text files written by other programs: byte order marks, line ends, old encodings."""

from __future__ import annotations

from pathlib import Path

from acquisition._errors import DataError, convert_read_errors
from rig import read_bounded


def read_text(path: Path) -> str:
    """Read a text file: UTF-8 with or without a byte order mark, otherwise Latin-1.

    Raises
    ------
    MissingPathError
        If there is no such file.
    DataError
        If it cannot be read, is not text, or is larger than 16 MB.
    """
    with convert_read_errors(path):
        data = read_bounded(path)
    if b"\0" in data:
        raise DataError(f"{path}: not a text file: save it as text in UTF-8")
    return text_of(data)


def text_of(data: bytes) -> str:
    """Decode UTF-8 with or without a byte order mark, otherwise Latin-1."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")  # names written by old Windows programs


def numbered_lines(text: str) -> list[tuple[int, str]]:
    """Return (line number from 1, stripped text) of the lines that are not blank."""
    stripped = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1)]
    return [(number, line) for number, line in stripped if line]
