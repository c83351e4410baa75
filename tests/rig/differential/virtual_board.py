"""The virtual board behind a pty, with a clock that stops between orders.

python virtual_board.py STEPS, the number of steps of a sequence that the board stores.

A program with the orders of ``board-host stepped`` (see ``rig/firmware/host/board.cpp``). Its
answer also has the time of its next action, ``"next": US``, and for each line that it received, the
times of the last action before it and the next one after it: ``"due": [[US, US], ...]``.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import tty
from pathlib import Path

from simulator.bench import BenchState, BenchWriter
from simulator.led_board import ActiveInput, BoardFirmware, BoardOutputs, FaultyBoard, firmware

_US = 1000
# Time of a byte on the line, as in the host board.
_BYTE_NS = 94 * _US


class SteppedBoard:
    """The virtual board with a clock that orders set.

    Parameters
    ----------
    folder
        Folder for its bench state.
    """

    def __init__(self, folder: Path) -> None:
        path = folder / "bench.state"
        self._outputs = BoardOutputs(BenchWriter(path))
        self._active = ActiveInput(BenchState(path))
        self._now_ns = self._woken_ns = 0
        self._board = FaultyBoard(BoardFirmware(36, self._outputs, self._active, 0), self._outputs)
        self._fd, self._slave = os.openpty()
        tty.setraw(self._slave)
        _print({"port": os.ttyname(self._slave)})

    def obey(self, order: str) -> None:
        """Carry out one order."""
        match order.split():
            case ["step", size, until_us]:
                pieces = [bytes((byte,)) for byte in self._read(int(size))]
                self._step(pieces, _BYTE_NS, int(until_us) * _US)
            case ["burst", size, until_us]:
                pieces = self._read(int(size)).split(b"\n")
                pieces = [piece + b"\n" for piece in pieces[:-1]] + pieces[-1:]
                self._step(pieces, 0, int(until_us) * _US)
            case ["active", level]:
                self._active.set(level == "1", self._now_ns)
                self._board.advance(self._now_ns)
            case ["reset"]:
                self._board.reset(self._now_ns)

    def _read(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            data += os.read(self._fd, size - len(data))
        return data

    def _step(self, pieces: list[bytes], apart_ns: int, until_ns: int) -> None:
        said, due = b"", []
        for piece in pieces:
            said += self._pass(self._now_ns + apart_ns)
            if piece.endswith(b"\n"):
                due.append((self._woken_ns // _US, self._next_ns() // _US))
            self._board.receive(piece, self._now_ns)
            said += self._board.advance(self._now_ns)
        said += self._pass(until_ns)
        os.write(self._fd, said)
        for event in self._outputs.events(self._now_ns):
            _print(event)
        stepped = {"us": self._now_ns // _US, "stepped": len(said)}
        _print({**stepped, "next": self._next_ns() // _US, "due": due})

    def _next_ns(self) -> int:
        return min(self._board.next_ns(self._now_ns), self._outputs.next_event_ns(self._now_ns))

    def _pass(self, until_ns: int) -> bytes:
        said = b""
        while self._now_ns < until_ns:
            due_ns = max(self._now_ns + 1, self._next_ns())
            if due_ns <= until_ns:
                self._woken_ns = due_ns
            self._now_ns = min(until_ns, due_ns)
            said += self._board.advance(self._now_ns)
        return said


def _print(what: object) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    firmware.MAX_STEPS = int(sys.argv[1])
    with tempfile.TemporaryDirectory() as folder:
        board = SteppedBoard(Path(folder))
        for order in sys.stdin:
            board.obey(order)
