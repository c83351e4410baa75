"""The virtual LED board as a process with a serial port, a pty (POSIX).

``python -P -m simulator.board [LEDS [events]]`` writes one JSON line, ``{"port": ...,
"bench_state": ...}``. With ``events``, it writes one more line for every edge: ``{"us": 81, "lit":
[7], "levels": [4095]}`` when an LED turns on or off, ``{"us": 81, "trigger": 1}`` for the trigger
line. It reads lines from standard input: a JSON list of `BoardFault` that replaces the faults;
``active 1`` or ``active 0``, which sets the level of the exposure-active input; ``reset``.

The port is a symbolic link. Its path stays the same when the board is unplugged and plugged in
again. When standard input closes or the parent dies, the process ends as soon as the current flash
or sequence has ended, as on a real board, and removes its files.
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

from simulator.bench.owned_folder import OwnedFolder
from simulator.bench.state import BenchState, BenchWriter
from simulator.led_board.faults import FaultyBoard, PowerCutError, faults_from_json
from simulator.led_board.firmware import BoardFirmware
from simulator.led_board.outputs import ActiveInput, BoardOutputs

_STDIN = 0
# Interval at which the process checks for its parent's death while standard input is open.
_TICK_NS = 100_000_000


class _Port(contextlib.AbstractContextManager["_Port"]):
    """A pty behind a symbolic link."""

    def __init__(self, link: Path) -> None:
        self.fd, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self.fd, False)
        # Last, so that no program opens a line that is not ready.
        link.symlink_to(os.ttyname(self._slave))
        self._link = link

    def __exit__(self, *_: object) -> None:
        self._link.unlink(missing_ok=True)
        os.close(self.fd)
        os.close(self._slave)


class _Process:
    """The board, its wires, and the connection to the parent process."""

    def __init__(self, leds: int, folder: Path, *, prints_events: bool) -> None:
        self._path = folder / "bench.state"
        self._outputs = BoardOutputs(BenchWriter(self._path))
        self._active = ActiveInput(BenchState(self._path))
        firmware = BoardFirmware(leds, self._outputs, self._active, time.monotonic_ns())
        self._board = FaultyBoard(firmware, self._outputs)
        self._link = folder / "port"
        self._parent = os.getppid()
        self._attached = True
        self._prints_events = prints_events
        self._orders = b""

    def run(self) -> None:
        """Run the board until the parent no longer needs it."""
        port = _Port(self._link)
        _print_line({"port": str(self._link), "bench_state": str(self._path)})
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
            sources = [fd, _STDIN] if self._attached else [fd]
            ready, _, _ = select.select(sources, [], [], self._wait_s())
            data = os.read(fd, 4096) if fd in ready else b""
            # Read after the port, with a second select: faults that were set before a command was
            # sent must apply to it.
            if self._attached and select.select([_STDIN], [], [], 0)[0]:
                self._obey(os.read(_STDIN, 4096))
            self._attached = self._attached and os.getppid() == self._parent
            self._board.receive(data, time.monotonic_ns())
            now_ns = time.monotonic_ns()
            # If no program reads and the line is full, bytes are lost, as on a wire.
            with contextlib.suppress(BlockingIOError):
                os.write(fd, self._board.advance(now_ns))
            if self._prints_events:
                for event in self._outputs.events(now_ns):
                    _print_line(event)

    def _wait_s(self) -> float:
        now_ns = time.monotonic_ns()
        due_ns = min(now_ns + _TICK_NS, self._board.next_ns(now_ns))
        if self._prints_events:
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
                self._board.set_faults(faults_from_json(line))


def serve(leds: int, *, prints_events: bool = False) -> None:
    """Open a pty, print its path, and run the board until the parent no longer needs it."""
    folder = contextlib.closing(OwnedFolder("sgp-board-"))
    with folder as owned, contextlib.suppress(KeyboardInterrupt):
        _Process(leds, owned.path, prints_events=prints_events).run()


def _print_line(content: object) -> None:
    # The reader may have gone.
    with contextlib.suppress(BrokenPipeError):
        sys.stdout.write(json.dumps(content) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    serve(int(sys.argv[1]) if len(sys.argv) > 1 else 36, prints_events=sys.argv[2:] == ["events"])
