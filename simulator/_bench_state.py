"""The light in the room: which LED burned when, in a small file that processes share.

The virtual board writes it, virtual cameras read it. Layout, little-endian, for readers in any
language: a header of 32 bytes (8 bytes ``SGPBENCH``; u32 version 1; u32 ring length R; u64 change
counter, odd while a change is being written; u64 count of periods), then R periods of 24 bytes
(i64 LED; i64 start; i64 end; CLOCK_MONOTONIC in nanoseconds). Period k lies at slot k mod R. A
reader copies the file, and copies again if the change counter was odd or has moved.

The end of a period is written when it begins, as the end of the declared hold, and brought forward
when the LED is turned off earlier: like a timer set in hardware, it needs nobody awake to be exact,
and a board that has died is dark by then.
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from rig import RigError

RING = 64
_HEADER = struct.Struct("<8sIIQQ")
_PERIOD = struct.Struct("<qqq")
_COUNTERS = struct.Struct("<QQ")
_COUNTERS_AT = 16
_MAGIC = b"SGPBENCH"
_VERSION = 1
SIZE = _HEADER.size + RING * _PERIOD.size


@dataclass(frozen=True)
class LitPeriod:
    """One LED burning from ``start_ns`` up to ``end_ns``, which may still lie ahead."""

    led: int
    start_ns: int
    end_ns: int


class BenchWriter:
    """The board's side: states what burns. There is one writer per file."""

    def __init__(self, path: Path) -> None:
        header = _HEADER.pack(_MAGIC, _VERSION, RING, 0, 0)
        path.write_bytes(header.ljust(SIZE, b"\0"))
        with path.open("r+b") as file:
            self._map = mmap.mmap(file.fileno(), SIZE)
        self._changes = 0
        self._count = 0
        self._last = LitPeriod(-1, 0, 0)

    def led(self, now_ns: int) -> int | None:
        """Return the LED that burns now."""
        return self._last.led if now_ns < self._last.end_ns else None

    def light(self, led: int, now_ns: int, end_ns: int) -> None:
        """Let exactly this LED burn until ``end_ns``."""
        self.put_out(now_ns)
        self._last = LitPeriod(led, now_ns, end_ns)
        self._count += 1
        self._write()

    def put_out(self, now_ns: int) -> None:
        """Let nothing burn."""
        if now_ns < self._last.end_ns:
            self._last = LitPeriod(self._last.led, self._last.start_ns, now_ns)
            self._write()

    def close(self) -> None:
        """Let go of the file."""
        self._map.close()

    def _write(self) -> None:
        _COUNTERS.pack_into(self._map, _COUNTERS_AT, 2 * self._changes + 1, self._count)
        slot = _HEADER.size + (self._count - 1) % RING * _PERIOD.size
        _PERIOD.pack_into(self._map, slot, self._last.led, self._last.start_ns, self._last.end_ns)
        self._changes += 1
        _COUNTERS.pack_into(self._map, _COUNTERS_AT, 2 * self._changes, self._count)


class BenchState:
    """The camera's side: sees what burns.

    Raises
    ------
    RigError
        If the file is absent or is no bench state.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            with path.open("rb") as file:
                self._map = mmap.mmap(file.fileno(), SIZE, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            raise RigError(f"{path}: the bench state cannot be read ({error})") from error
        if _HEADER.unpack_from(self._map)[:3] != (_MAGIC, _VERSION, RING):
            self._map.close()
            raise RigError(f"{path}: not a bench state of version {_VERSION}")

    @property
    def changes(self) -> int:
        """How often the light has changed by command."""
        changes: int = _COUNTERS.unpack_from(self._map, _COUNTERS_AT)[0] // 2
        return changes

    def periods(self) -> tuple[LitPeriod, ...]:
        """Return the periods that are still in the ring, oldest first."""
        while True:
            snapshot = self._map[:]
            changes, count = _COUNTERS.unpack_from(snapshot, _COUNTERS_AT)
            if changes % 2 == 0 and _COUNTERS.unpack_from(self._map, _COUNTERS_AT)[0] == changes:
                return tuple(_periods(snapshot, count))

    def led(self, now_ns: int) -> int | None:
        """Return the LED that burns at a time of the monotonic clock."""
        for period in self.periods():
            if period.start_ns <= now_ns < period.end_ns:
                return period.led
        return None

    def lit_ns(self, start_ns: int, end_ns: int) -> dict[int, int]:
        """Return for how long each LED burned between two times, LEDs that did not left out.

        Raises
        ------
        RigError
            If the light changed so often since ``start_ns`` that the ring has forgotten it.
        """
        periods = self.periods()
        if len(periods) == RING and periods[0].start_ns > start_ns:
            raise RigError(f"{self._path}: more than {RING} LEDs lit during one exposure")
        lit: dict[int, int] = {}
        for period in periods:
            overlap = min(end_ns, period.end_ns) - max(start_ns, period.start_ns)
            if overlap > 0:
                lit[period.led] = lit.get(period.led, 0) + overlap
        return lit

    def close(self) -> None:
        """Let go of the file."""
        self._map.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _periods(snapshot: bytes, count: int) -> Iterator[LitPeriod]:
    for index in range(max(0, count - RING), count):
        yield LitPeriod(*_PERIOD.unpack_from(snapshot, _HEADER.size + index % RING * _PERIOD.size))
