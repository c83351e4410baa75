"""The virtual LED board as a process: real bytes over a pty (POSIX).

``python -m simulator.board [LEDS]`` writes one JSON line, ``{"port": ..., "bench_state": ...}``.
Every line on its standard input is a JSON list of `BoardFault`: those that strike from then on. It
lives until its standard input closes or its parent dies, and from then to the end of the declared
hold, as a real board would. The bench-state file goes with it.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import sys
import tempfile
import time
import tty
from pathlib import Path

from rig import LineBuffer
from simulator._bench_state import BenchWriter
from simulator._board_faults import BoardFaults, FaultyBoard, PowerCutError
from simulator._board_firmware import BoardFirmware

_STDIN = 0
# How soon a parent's death is noticed where standard input stays open.
_TICK_S = 0.1


def serve(leds: int) -> None:
    """Open a pty, say where it is, and be the board until nobody needs it any more."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    handle, name = tempfile.mkstemp(prefix="sgp-bench-", suffix=".state")
    os.close(handle)
    bench = BenchWriter(Path(name))
    board = FaultyBoard(BoardFirmware(leds, bench, time.monotonic_ns()))
    try:
        sys.stdout.write(json.dumps({"port": os.ttyname(slave), "bench_state": name}) + "\n")
        sys.stdout.flush()
        with contextlib.suppress(PowerCutError, KeyboardInterrupt):
            _run(board, master)
    finally:
        Path(name).unlink(missing_ok=True)


def _run(board: FaultyBoard, master: int) -> None:
    parent = os.getppid()
    wire, orders = LineBuffer(), b""
    due: list[tuple[int, bytes]] = []
    attached = True
    while attached or board.firmware.bench.led(time.monotonic_ns()) is not None:
        wait_s = min([_TICK_S, *(max(0.0, (at - time.monotonic_ns()) / 1e9) for at, _ in due)])
        ready, _, _ = select.select([master, _STDIN] if attached else [master], [], [], wait_s)
        received = wire.feed(os.read(master, 4096)) if master in ready else []
        # Only now, and asked again: faults that were ordered before a command must strike it.
        if attached and select.select([_STDIN], [], [], 0)[0]:
            data = os.read(_STDIN, 4096)
            attached = bool(data)
            *lines, orders = (orders + data).split(b"\n")
            for line in lines:
                board.set_faults(BoardFaults.validate_json(line))
        attached = attached and os.getppid() == parent
        for line in received:
            reply, at = board.handle(line, time.monotonic_ns())
            due.append((at, reply))
        now_ns = time.monotonic_ns()
        for _, reply in sorted(item for item in due if item[0] <= now_ns):
            # Nobody reads and the line is full: lost, as on a wire.
            with contextlib.suppress(BlockingIOError):
                os.write(master, reply)
        due = [item for item in due if item[0] > now_ns]


if __name__ == "__main__":
    serve(int(sys.argv[1]) if len(sys.argv) > 1 else 36)
