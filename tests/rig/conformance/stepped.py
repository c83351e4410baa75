"""A board program under test whose clock is that of a world."""

from __future__ import annotations

import os

from simulator.world import World
from tests.rig.board_program import Event
from tests.rig.conformance.board import BoardUnderTest

# As often as the simulator of the processor looks at its port in real time.
SLICE_NS = 250_000
BYTE_NS = 94_000


class SteppedUnderTest(BoardUnderTest):
    """Starts a board program that can be stepped, and lets it follow the time of a world.

    Parameters
    ----------
    command
        Command that starts the program in real time; with ``stepped``, it accepts steps.
    world
        World in which this is called.
    late_us
        See `BoardUnderTest`.
    """

    def __init__(self, command: list[str], world: World, *, late_us: int) -> None:
        self._scheduler = world.scheduler
        self._began_ns = world.scheduler.now_ns
        self._passed_us = 0
        self._said = b""
        self._unread: list[Event] = []
        super().__init__([*command, "stepped"], late_us=late_us)

    def order(self, text: str) -> None:
        """Send the program an order without waiting for it."""
        self._follow()
        super().order(text)
        # The program discards what arrives before it has read ``reset``.
        self._step(b"")

    def _send(self, data: bytes) -> None:
        self._follow()
        self._pass(len(data) * BYTE_NS)
        self._follow(data)

    def _receive(self) -> bytes:
        said, self._said = self._said, b""
        return said

    def _read_events(self) -> list[Event]:
        events, self._unread = self._unread, []
        return events

    def _await(self, ends_s: float, *fds: int) -> list[int]:
        ends_ns = round(ends_s * 1e9)
        while True:
            self._follow()
            there = {self._fd: self._said, self._output: self._unread}
            ready = [fd for fd in fds if there[fd]]
            left_ns = ends_ns - self._scheduler.now_ns
            if ready or left_ns <= 0:
                return ready
            self._pass(min(SLICE_NS, left_ns))

    def _pass(self, ns: int) -> None:
        scheduler = self._scheduler
        scheduler.wait(lambda: False, scheduler.now_ns + ns)

    def _follow(self, data: bytes = b"") -> None:
        """Let the program run until now; it receives the bytes on the way."""
        now_us = (self._scheduler.now_ns - self._began_ns) // 1000
        if now_us > self._passed_us:
            self._passed_us = now_us
            self._step(data)

    def _step(self, data: bytes) -> None:
        if data:
            os.write(self._fd, data)
        super().order(f"step {len(data)} {self._passed_us}")
        stepped = None
        while stepped is None:
            for event in super()._read_events():
                if "stepped" in event:
                    stepped = event["stepped"]
                else:
                    self._unread.append(event)
        while stepped > 0:
            said = os.read(self._fd, 4096)
            self._said += said
            stepped -= len(said)
