"""A board program whose clock stops between orders, and the result of a step."""

from __future__ import annotations

import binascii
import os
import select
import time
from collections import deque
from dataclasses import dataclass

from tests.rig.board_program import BoardProgram, Event

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


class Program(BoardProgram):
    """Communicates with a stepped board program (see ``rig/firmware/host/board.cpp``)."""

    def __init__(self, command: list[str]) -> None:
        super().__init__(command)
        self._events: deque[Event] = deque()
        self._open_port(self._event()["port"])
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

    def _event(self) -> Event:
        while not self._events:
            assert select.select([self._output], [], [], _PATIENCE_S)[0], "the program is stuck"
            self._events.extend(self._read_events())
        return self._events.popleft()


def whole(reply: bytes) -> bool:
    """Return whether a reply has the correct checksum."""
    body, _, crc = reply.partition(b"*")
    return crc == b"%04X" % binascii.crc_hqx(body, 0xFFFF)
