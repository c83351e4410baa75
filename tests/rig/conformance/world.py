"""The board of a world under test."""

from __future__ import annotations

from rig.host import lines
from simulator.world import World
from tests.rig.board_program import Event
from tests.rig.conformance.board import BoardUnderTest


class WorldUnderTest(BoardUnderTest):
    """Communicates with the board of a world; to be used in it.

    Parameters
    ----------
    world
        The world, whose clock is exact.
    """

    def __init__(self, world: World) -> None:
        self._scheduler, self._board = world.scheduler, world.board
        self._line = lines.open_line(self._board.port, timeout=0)
        self._fd, self._output = range(2)
        self._unread: list[Event] = []
        self._begin(20)

    def order(self, text: str) -> None:
        """Act on the board as a program acts on an order."""
        if text == "reset":
            self._board.reset()
        else:
            self._board.set_active(text == "active 1")

    def close(self) -> None:
        """Close the line."""
        self._line.close()

    def _first_line(self) -> str:
        return self._board.port

    def _open_port(self, port: str) -> None:
        pass

    def _send(self, data: bytes) -> None:
        self._line.write(data)

    def _receive(self) -> bytes:
        return self._line.read(self._line.in_waiting)

    def _read_events(self) -> list[Event]:
        events, self._unread = self._unread, []
        return events

    def _await(self, ends_s: float, *fds: int) -> list[int]:
        board, scheduler = self._board, self._scheduler

        def ready() -> list[int]:
            board.advance()
            self._unread += board.outputs.events(scheduler.now_ns)
            there = {self._fd: board.arrived, self._output: self._unread}
            return [fd for fd in fds if there[fd]]

        def next_ns() -> int:
            return min(board.due_ns, board.outputs.next_event_ns(scheduler.now_ns))

        scheduler.step("wait for the board")
        scheduler.wait(lambda: bool(ready()), round(ends_s * 1e9), next_ns)
        return ready()
