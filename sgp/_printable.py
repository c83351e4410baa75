"""Text from files and folders made fit for a terminal, which would obey some of it."""

from __future__ import annotations

import re

# Control characters of C0 and C1, line and paragraph separators, marks that turn the direction of
# writing, the byte order mark, and halves of characters, which stand for bytes that are no UTF-8.
_COMMANDS = "\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff"
_OBEYED = re.compile(f"[\x00-\x1f{_COMMANDS}]")
_BESIDE_JSON = re.compile(f"[{_COMMANDS}]")


def printable(text: str) -> str:
    """Return one line of text with everything escaped that is no character to be seen."""
    return _OBEYED.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)


def printable_lines(text: str) -> str:
    """Return text of several lines, each as `printable` does."""
    return "\n".join(map(printable, text.split("\n")))


def printable_json(text: str) -> str:
    """Escape in a JSON text what JSON itself does not: such characters occur in strings alone."""
    return _BESIDE_JSON.sub(lambda found: f"\\u{ord(found[0]):04x}", text)
