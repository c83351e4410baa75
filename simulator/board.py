"""The virtual LED board as a process: real bytes over a pty (POSIX).

``python -P -m simulator.board [LEDS [events]]`` writes one JSON line, ``{"port": ...,
"bench_state": ...}``, and with ``events`` one more for every edge: ``{"us": 81, "lit": [7],
"levels": [4095]}`` whenever an LED goes on or off, ``{"us": 81, "trigger": 1}`` for the trigger
line. Its standard input takes lines: a JSON list of `BoardFault`, those that strike from then on;
``active 1`` and ``active 0``, the level of the exposure-active input; ``reset``.

The port is a symbolic link, which stays the same when the board is unplugged and comes back. The
process lives until its standard input closes or its parent dies, and from then to the end of what
is burning, as a real board would. Its files go with it.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import sys
import time
import tty
from pathlib import Path
from typing import Self

from simulator._bench_state import BenchState, BenchWriter
from simulator._board.faults import BoardFaults, FaultyBoard, PowerCutError
from simulator._board.firmware import BoardFirmware
from simulator._board.outputs import ActiveInput, BoardOutputs
from simulator._owned_folder import OwnedFolder

_STDIN = 0
# How soon a parent's death is noticed where standard input stays open.
_TICK_NS = 100_000_000


class _Port:
    """A pty behind a symbolic link."""

    def __init__(self, link: Path) -> None:
        self.fd, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self.fd, False)
        # Last, so that nobody opens a line that is not ready.
        link.symlink_to(os.ttyname(self._slave))
        self._link = link

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._link.unlink(missing_ok=True)
        os.close(self.fd)
        os.close(self._slave)


class _Process:
    """The board, its wires, and whoever started it."""

    def __init__(self, leds: int, folder: Path, *, tells_events: bool) -> None:
        self._path = folder / "bench.state"
        self._outputs = BoardOutputs(BenchWriter(self._path))
        self._active = ActiveInput(BenchState(self._path))
        firmware = BoardFirmware(leds, self._outputs, self._active, time.monotonic_ns())
        self._board = FaultyBoard(firmware, self._outputs)
        self._link = folder / "port"
        self._parent = os.getppid()
        self._attached = True
        self._tells_events = tells_events
        self._orders = b""

    def run(self) -> None:
        """Be the board until nobody needs it any more."""
        port = _Port(self._link)
        _tell({"port": str(self._link), "bench_state": str(self._path)})
        while True:
            try:
                with port:
                    self._serve(port.fd)
                return
            except PowerCutError as cut:
                if cut.back_ns is None:
                    return
                time.sleep(max(0.0, (cut.back_ns - time.monotonic_ns()) / 1e9))
            self._board.reset(time.monotonic_ns())
            port = _Port(self._link)

    def _serve(self, fd: int) -> None:
        while self._attached or self._board.firmware.light.state not in ("IDLE", "HALT"):
            ready, _, _ = select.select(self._sources(fd), [], [], self._wait_s())
            data = os.read(fd, 4096) if fd in ready else b""
            # Only now, and asked again: faults that were ordered before a command must strike it.
            if self._attached and select.select([_STDIN], [], [], 0)[0]:
                self._obey(os.read(_STDIN, 4096))
            self._attached = self._attached and os.getppid() == self._parent
            self._board.receive(data, time.monotonic_ns())
            now_ns = time.monotonic_ns()
            # Nobody reads and the line is full: lost, as on a wire.
            with contextlib.suppress(BlockingIOError):
                os.write(fd, self._board.advance(now_ns))
            if self._tells_events:
                for event in self._outputs.events(now_ns):
                    _tell(event)

    def _sources(self, fd: int) -> list[int]:
        return [fd, _STDIN] if self._attached else [fd]

    def _wait_s(self) -> float:
        now_ns = time.monotonic_ns()
        due_ns = min(now_ns + _TICK_NS, self._board.next_ns(now_ns))
        if self._tells_events:
            due_ns = min(due_ns, self._outputs.next_event_ns(now_ns))
        return max(0.0, (due_ns - now_ns) / 1e9)

    def _obey(self, data: bytes) -> None:
        self._attached = bool(data)
        *lines, self._orders = (self._orders + data).split(b"\n")
        for line in lines:
            now_ns = time.monotonic_ns()
            if line == b"reset":
                self._board.reset(now_ns)
            elif line in (b"active 0", b"active 1"):
                self._active.set(line == b"active 1", now_ns)
            else:
                self._board.set_faults(BoardFaults.validate_json(line))


def serve(leds: int, *, tells_events: bool = False) -> None:
    """Open a pty, say where it is, and be the board until nobody needs it any more."""
    folder = OwnedFolder("sgp-board-")
    try:
        with contextlib.suppress(KeyboardInterrupt):
            _Process(leds, folder.path, tells_events=tells_events).run()
    finally:
        folder.close()


def _tell(what: object) -> None:
    # Nobody may be reading any more.
    with contextlib.suppress(BrokenPipeError):
        sys.stdout.write(json.dumps(what) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    serve(int(sys.argv[1]) if len(sys.argv) > 1 else 36, tells_events=sys.argv[2:] == ["events"])
