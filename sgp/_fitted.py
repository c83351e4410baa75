"""Fit lines to the width of a terminal."""

from __future__ import annotations

import os
import re
from typing import Any, Final

# A word, or a command in backticks: a line break inside it would break it when it is pasted.
_WORD: Final = re.compile(r"(?:`[^`]*`|\S)+")
# The last column of a row begins after two spaces or more.
_COLUMN: Final = re.compile(r"(?<=\S) {2,}(?=\S)")
_LEAST: Final = 40
_FURTHEST: Final = 30


def fitted(line: str, stream: Any) -> str:
    """Return a line broken between words for a terminal; unchanged for files and pipes.

    The lines after the first begin under the last column of a row, or are indented. Words and
    commands in backticks that are longer than a line are not broken.
    """
    width = _columns(stream)
    if width is None or len(line) <= width:
        return line
    starts = [match.end() for match in _COLUMN.finditer(line) if match.end() <= _FURTHEST]
    indent = starts[-1] if starts else len(line) - len(line.lstrip()) + 2
    kept = starts[-1] if starts else len(line) - len(line.lstrip())
    lines: list[str] = []
    current, empty = line[:kept], True
    for word in _WORD.findall(line[kept:]):
        if not empty and len(current) + 1 + len(word) > width:
            lines.append(current)
            current, empty = " " * indent, True
        current += word if empty else f" {word}"
        empty = False
    return "\n".join([*lines, current])


def _columns(stream: Any) -> int | None:
    """Return the width of a terminal, at least 40; None if the stream is no terminal."""
    try:
        if not stream.isatty():
            return None
        return max(os.get_terminal_size(stream.fileno()).columns, _LEAST)
    except (AttributeError, OSError, ValueError):
        return None
