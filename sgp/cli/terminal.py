"""What reaches a terminal: control characters are escaped, lines fitted, failing writes ignored."""

from __future__ import annotations

import io
import os
import re
import sys
from contextlib import suppress
from typing import Any, Final, TextIO, cast

# C0 and C1 control characters, line and paragraph separators, marks that change the direction of
# writing, the byte order mark, and surrogates, which represent bytes that are not UTF-8.
_COMMANDS = "\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff"
_OBEYED = re.compile(f"[\x00-\x1f{_COMMANDS}]")
_BESIDE_JSON = re.compile(f"[{_COMMANDS}]")


def printable(text: str) -> str:
    """Return one line of text with all control characters escaped."""
    return _OBEYED.sub(lambda match: match[0].encode("unicode_escape").decode("ascii"), text)


# SGR codes of the words that begin a line and say how serious it is.
_COLOURS: Final = {
    "note": "36",
    "warning": "33",
    "error": "1;31",
    "good": "32",
    "check": "33",
    "do not use": "1;31",
}


def coloured(line: str, stream: Any) -> str:
    """Colour the word before the first colon if it says how serious a line is.

    Lines for files, pipes and dumb terminals stay plain, and all with the environment variable
    ``NO_COLOR``.
    """
    word = line.partition(":")[0]
    code = _COLOURS.get(word)
    if code is None or os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        return line
    if _columns(stream) is None:
        return line
    return f"\x1b[{code}m{word}\x1b[0m{line[len(word) :]}"


def printable_lines(text: str) -> str:
    """Apply `printable` to each line of a text."""
    return "\n".join(map(printable, text.split("\n")))


def printable_json(text: str) -> str:
    """Escape the control characters that JSON leaves as they are; they occur only in strings."""
    return _BESIDE_JSON.sub(lambda match: f"\\u{ord(match[0]):04x}", text)


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
    return line if width is None else wrapped(line, width)


def wrapped(line: str, width: int) -> str:
    """Return a line broken between words, see `fitted`."""
    if len(line) <= width:
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


class _Stderr(io.TextIOBase):
    """Proxy for the current ``sys.stderr``; after a failed write it discards all output."""

    def write(self, text: str) -> int:
        try:
            if (file := _present()) is not None:
                file.write(text)
        except (OSError, ValueError):  # a full disk, a reader that has exited, a closed file
            _give_up()
        return len(text)

    def flush(self) -> None:
        try:
            if (file := _present()) is not None:
                file.flush()
        except (OSError, ValueError):
            _give_up()

    def isatty(self) -> bool:
        with suppress(OSError, ValueError):
            return (file := _present()) is not None and file.isatty()
        return False

    def fileno(self) -> int:
        if (file := _present()) is None:
            raise io.UnsupportedOperation("there is no stderr")
        return int(file.fileno())


STDERR: Final = cast(TextIO, _Stderr())


def _present() -> Any:
    # A progress bar replaces sys.stderr by a proxy that writes to the real file.
    return getattr(sys.stderr, "rich_proxied_file", sys.stderr)


def _give_up() -> None:
    """Discard all later output, including that of the interpreter when it exits."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, STDERR.fileno())
        os.close(nowhere)
