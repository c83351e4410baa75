"""A stderr that never raises: a log that cannot be written must not end the work."""

from __future__ import annotations

import io
import os
import sys
from contextlib import suppress
from typing import Any, Final, TextIO, cast


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
