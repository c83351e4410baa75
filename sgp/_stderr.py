"""stderr that nothing fails at: a log that cannot be written must not end the work."""

from __future__ import annotations

import io
import os
import sys
from contextlib import suppress
from typing import Any, Final, TextIO, cast


class _Stderr(io.TextIOBase):
    """Whatever ``sys.stderr`` is at the time; what it cannot take is lost, like all after it."""

    def write(self, text: str) -> int:
        try:
            if (file := _present()) is not None:
                file.write(text)
        except (OSError, ValueError):  # a full disk, a reader that has gone; a file that is closed
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
    # A bar puts itself in the place of stderr, and writes to this here.
    return getattr(sys.stderr, "rich_proxied_file", sys.stderr)


def _give_up() -> None:
    """Let what is written later, by the interpreter at its end too, go nowhere."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, STDERR.fileno())
        os.close(nowhere)
