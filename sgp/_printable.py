"""Escape control characters in texts from files and folders before they reach a terminal."""

from __future__ import annotations

import re

# C0 and C1 control characters, line and paragraph separators, marks that change the direction of
# writing, the byte order mark, and surrogates, which represent bytes that are not UTF-8.
_COMMANDS = "\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff"
_OBEYED = re.compile(f"[\x00-\x1f{_COMMANDS}]")
_BESIDE_JSON = re.compile(f"[{_COMMANDS}]")


def printable(text: str) -> str:
    """Return one line of text with all control characters escaped."""
    return _OBEYED.sub(lambda match: match[0].encode("unicode_escape").decode("ascii"), text)


def printable_lines(text: str) -> str:
    """Apply `printable` to each line of a text."""
    return "\n".join(map(printable, text.split("\n")))


def printable_json(text: str) -> str:
    """Escape the control characters that JSON leaves as they are; they occur only in strings."""
    return _BESIDE_JSON.sub(lambda match: f"\\u{ord(match[0]):04x}", text)
