"""A board program as a child process: its port, its events and orders to it."""

from __future__ import annotations

import json
import os
import subprocess
import tty
from types import TracebackType
from typing import Any, Self

Event = dict[str, Any]


class BoardProgram:
    """Starts a board program; subclasses open its port and communicate with it.

    Parameters
    ----------
    command
        Command that starts the program. It prints its events as JSON lines, the first of which is
        ``{"port": PATH}``; its standard input accepts orders; it ends when its standard input is
        closed.
    """

    def __init__(self, command: list[str]) -> None:
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._process.stdout is not None
        self._output = self._process.stdout.fileno()
        self._half_line = b""
        self._fd = -1

    def order(self, text: str) -> None:
        """Send the program an order without waiting for it."""
        assert self._process.stdin is not None
        self._process.stdin.write(text.encode() + b"\n")
        self._process.stdin.flush()

    def close(self) -> None:
        """End the program."""
        if self._fd >= 0:
            os.close(self._fd)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        try:
            self._process.wait(60)
        finally:
            self._process.kill()
            self._process.wait()
            self._process.stdout.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _open_port(self, port: str) -> None:
        self._fd = os.open(port, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self._fd)

    def _read_events(self) -> list[Event]:
        """Return the events that the program has printed; wait if there is no output."""
        data = os.read(self._output, 65536)
        assert data, "the program has ended"
        *lines, self._half_line = (self._half_line + data).split(b"\n")
        return [json.loads(line) for line in lines]
