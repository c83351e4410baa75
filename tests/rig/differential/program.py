"""A board program whose clock stops between orders, and the result of a step."""

from __future__ import annotations

import binascii
import json
import os
import select
import subprocess
import time
import tty
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

Event = dict[str, Any]
_PATIENCE_S = 8.0
# Time that a byte takes on the serial line.
BYTE_US = 94


@dataclass(frozen=True)
class Step:
    """Replies and events of a board in a step.

    Parameters
    ----------
    replies
        The lines that the board sent, without line ends.
    events
        Its edges, in order: ``{"us", "lit", "levels"}`` and ``{"us", "trigger"}``.
    next_us
        When the next action of the virtual board is due; None for other boards.
    due_us
        For each line that the virtual board received: times of its last and its next action.
    """

    replies: tuple[bytes, ...]
    events: tuple[Event, ...]
    next_us: int | None = None
    due_us: tuple[tuple[int, int], ...] = ()


class Program:
    """Starts a stepped board program and communicates with it over its port.

    Parameters
    ----------
    command
        Command that starts the program (see ``rig/firmware/host/board.cpp``).
    """

    def __init__(self, command: list[str]) -> None:
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._process.stdout is not None
        self._output = self._process.stdout.fileno()
        self._rest = b""
        self._fd = os.open(self._event()["port"], os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self._fd)
        self._half_reply = b""

    def step(self, data: bytes, until_us: int, *, burst: bool = False) -> Step:
        """Send bytes, advance the board's clock to a time, and return the board's actions.

        The bytes arrive at the speed of a serial line, or all at once if ``burst`` is set.
        """
        os.write(self._fd, data)
        self.order(f"{'burst' if burst else 'step'} {len(data)} {until_us}")
        events = []
        while "stepped" not in (event := self._event()):
            events.append(event)
        said = b""
        ends_s = time.monotonic() + _PATIENCE_S
        while len(said) < event["stepped"]:
            assert select.select([self._fd], [], [], ends_s - time.monotonic())[0], said
            said += os.read(self._fd, 4096)
        *lines, self._half_reply = (self._half_reply + said).split(b"\n")
        due_us = tuple((last_us, next_us) for last_us, next_us in event.get("due", ()))
        return Step(tuple(lines), tuple(events), event.get("next"), due_us)

    def order(self, text: str) -> None:
        """Send an order: ``active 1``, ``active 0`` or ``reset``."""
        assert self._process.stdin is not None
        self._process.stdin.write(text.encode() + b"\n")
        self._process.stdin.flush()

    def close(self) -> None:
        """End the program."""
        os.close(self._fd)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        try:
            self._process.wait(10)
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

    def _event(self) -> Event:
        while b"\n" not in self._rest:
            assert select.select([self._output], [], [], _PATIENCE_S)[0], "the program is stuck"
            data = os.read(self._output, 65536)
            assert data, "the program has ended"
            self._rest += data
        text, _, self._rest = self._rest.partition(b"\n")
        event: Event = json.loads(text)
        return event


def whole(reply: bytes) -> bool:
    """Return whether a reply has the correct checksum."""
    body, _, crc = reply.partition(b"*")
    return crc == b"%04X" % binascii.crc_hqx(body, 0xFFFF)
