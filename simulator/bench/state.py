"""State of light and trigger line of the bench, in a small file that processes share.

The virtual board writes light and trigger pulses. A virtual camera reads them and writes its
exposures. The layout, for readers in any language, is little-endian; times are CLOCK_MONOTONIC in
nanoseconds:

==========  ========================================================================
byte        content
==========  ========================================================================
0           8 bytes ``SGPBENCH``
8           u32 version 2
12          u32 R = 64, length of the ring of lit periods
16          u64 board's change counter, odd while the board is writing
24          u64 number of lit periods so far
32          u64 number of trigger pulses so far
40          u32 T = 64, length of the ring of trigger pulses
44          u32 X = 64, length of the ring of exposures
48          u64 camera's change counter, odd while the camera is writing
56          u64 number of exposures so far
64          R x (i32 LED; i32 dimming; i64 start; i64 end): lit period k at slot k mod R
then        T x (i64 number, from 0; i64 time): trigger pulses; time 2^63-1: cancelled
then        X x (i64 start; i64 end): exposures of the camera
==========  ========================================================================

The light of a period is that of the LED times ``1 - dimming / 4095``. A reader copies the file; if
the change counter of the writer was odd or has changed, the reader copies the file again.

The board writes ahead of time: it writes the end of a light when the light begins, and the light
and pulse of a flash or step as soon as they are certain, sometimes before they happen. When the
board receives a command to stop, it moves these ends forward and cancels the pulses. Like hardware
timers, the written times are exact even if no process runs then, and an LED turns off in time even
if the board's process has died.
"""

from __future__ import annotations

import mmap
import struct
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from rig import RigError
from rig.host import clock

RING = 64
FULL_LEVEL = 4095
NEVER_NS = 2**63 - 1
# A change takes microseconds, unless its process is suspended in the middle of it.
_WRITER_PATIENCE_S = 0.5
_MAGIC = b"SGPBENCH"
_VERSION = 2
_HEADER = struct.Struct("<8sIIQQQIIQQ")
_HEAD = (_MAGIC, _VERSION, RING)
_BOARD_COUNTERS = struct.Struct("<QQQ")
_BOARD_AT = 16
_CAMERA_COUNTERS = struct.Struct("<QQ")
_CAMERA_AT = 48
_PERIOD = struct.Struct("<iiqq")
_PAIR = struct.Struct("<qq")
_PERIODS_AT = _HEADER.size
_TRIGGERS_AT = _PERIODS_AT + RING * _PERIOD.size
_EXPOSURES_AT = _TRIGGERS_AT + RING * _PAIR.size
SIZE = _EXPOSURES_AT + RING * _PAIR.size


@dataclass(frozen=True)
class LitPeriod:
    """Period in which one LED is on, from ``start_ns`` to ``end_ns``; may be in the future.

    ``level`` is its brightness, 0 to 4095.
    """

    led: int
    start_ns: int
    end_ns: int
    level: int = FULL_LEVEL


@dataclass(frozen=True)
class TriggerPulse:
    """One rising edge of the trigger line, which may be in the future."""

    number: int
    time_ns: int


@dataclass(frozen=True)
class ExposurePeriod:
    """One exposure of the camera, whose end may be in the future."""

    start_ns: int
    end_ns: int


class BenchWriter:
    """Writes the board's part: lit periods and trigger pulses. A file has one `BenchWriter`."""

    def __init__(self, path: Path) -> None:
        header = _HEADER.pack(_MAGIC, _VERSION, RING, 0, 0, 0, RING, RING, 0, 0)
        path.write_bytes(header.ljust(SIZE, b"\0"))
        with path.open("r+b") as file:
            self._map = mmap.mmap(file.fileno(), SIZE)
        self._changes = 0
        self._lit = 0
        self._triggers = 0

    def light(self, led: int, start_ns: int, end_ns: int, level: int = FULL_LEVEL) -> int:
        """Record that an LED is on from ``start_ns`` to ``end_ns``; return the period's number."""
        number = self._lit
        self._lit += 1
        self._write({_period_at(number): _PERIOD.pack(led, FULL_LEVEL - level, start_ns, end_ns)})
        return number

    def end(self, period: int, end_ns: int) -> None:
        """Move the end of one of the last `RING` lit periods, at the earliest to its start."""
        at = _period_at(period)
        led, dimming, start_ns, _ = _PERIOD.unpack_from(self._map, at)
        self._write({at: _PERIOD.pack(led, dimming, start_ns, max(start_ns, end_ns))})

    def pulse(self, time_ns: int) -> int:
        """Record a trigger pulse at a time; return the number of the pulse."""
        number = self._triggers
        self._triggers += 1
        self._write({_trigger_at(number): _PAIR.pack(number, time_ns)})
        return number

    def put_out(self, now_ns: int) -> None:
        """Turn all LEDs off from now on, and cancel the pulses that are in the future."""
        changed = {}
        for number in range(max(0, self._lit - RING), self._lit):
            at = _period_at(number)
            led, dimming, start_ns, end_ns = _PERIOD.unpack_from(self._map, at)
            if end_ns > now_ns:
                changed[at] = _PERIOD.pack(led, dimming, start_ns, max(start_ns, now_ns))
        for number in range(max(0, self._triggers - RING), self._triggers):
            at = _trigger_at(number)
            if now_ns < _PAIR.unpack_from(self._map, at)[1] < NEVER_NS:
                changed[at] = _PAIR.pack(number, NEVER_NS)
        if changed:
            self._write(changed)

    def close(self) -> None:
        """Close the file."""
        self._map.close()

    def _write(self, changed: dict[int, bytes]) -> None:
        counts = self._lit, self._triggers
        _BOARD_COUNTERS.pack_into(self._map, _BOARD_AT, 2 * self._changes + 1, *counts)
        for at, data in changed.items():
            self._map[at : at + len(data)] = data
        self._changes += 1
        _BOARD_COUNTERS.pack_into(self._map, _BOARD_AT, 2 * self._changes, *counts)


class BenchState(AbstractContextManager["BenchState"]):
    """Reads lit periods, trigger pulses and exposures, and writes the camera's part.

    Raises
    ------
    RigError
        If the file is missing or is not a bench state.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            with path.open("r+b") as file:
                self._map = mmap.mmap(file.fileno(), SIZE)
        except (OSError, ValueError) as error:
            raise RigError(f"{path}: the bench state cannot be read ({error})") from error
        if _HEADER.unpack_from(self._map)[:3] != _HEAD:
            self._map.close()
            raise RigError(f"{path}: not a bench state of version {_VERSION}")

    @property
    def changes(self) -> int:
        """Number of changes of light or trigger by the board."""
        changes: int = _BOARD_COUNTERS.unpack_from(self._map, _BOARD_AT)[0] // 2
        return changes

    def periods(self) -> tuple[LitPeriod, ...]:
        """Return the lit periods that are still in the ring, oldest first."""
        return self._periods()[0]

    def triggers(self) -> tuple[TriggerPulse, ...]:
        """Return the trigger pulses that are still in the ring, without cancelled ones."""
        data, (_, _, count) = self._snapshot(_BOARD_COUNTERS, _BOARD_AT)
        pulses = (TriggerPulse(*pair) for pair in _ring(data, _PAIR, _TRIGGERS_AT, count))
        return tuple(pulse for pulse in pulses if pulse.time_ns != NEVER_NS)

    def exposures(self) -> tuple[ExposurePeriod, ...]:
        """Return the camera's exposures that are still in the ring, oldest first."""
        data, (_, count) = self._snapshot(_CAMERA_COUNTERS, _CAMERA_AT)
        return tuple(ExposurePeriod(*pair) for pair in _ring(data, _PAIR, _EXPOSURES_AT, count))

    def expose(self, start_ns: int, end_ns: int) -> None:
        """Record an exposure as soon as it begins. Only one camera per file does so."""
        changes, count = _CAMERA_COUNTERS.unpack_from(self._map, _CAMERA_AT)
        changes += changes % 2  # odd if the camera died while it wrote
        _CAMERA_COUNTERS.pack_into(self._map, _CAMERA_AT, changes + 1, count)
        _PAIR.pack_into(self._map, _EXPOSURES_AT + count % RING * _PAIR.size, start_ns, end_ns)
        _CAMERA_COUNTERS.pack_into(self._map, _CAMERA_AT, changes + 2, count + 1)

    def led(self, now_ns: int) -> int | None:
        """Return the LED that is on at a time of the monotonic clock; None if all are off."""
        for period in self.periods():
            if period.start_ns <= now_ns < period.end_ns:
                return period.led
        return None

    def lit_ns(self, start_ns: int, end_ns: int) -> dict[int, int]:
        """Return how long each LED was on between two times, without LEDs that were off.

        For a dimmed LED, it is the time at full brightness that gives the same light.

        Raises
        ------
        RigError
            If the light changed so often since ``start_ns`` that the ring no longer contains it.
        """
        periods, count = self._periods()
        if count > RING and periods[0].start_ns > start_ns:
            raise RigError(f"{self._path}: more than {RING} LEDs were on during one exposure")
        lit: dict[int, int] = {}
        for period in periods:
            overlap = min(end_ns, period.end_ns) - max(start_ns, period.start_ns)
            if overlap > 0:
                full_ns = overlap * period.level // FULL_LEVEL
                lit[period.led] = lit.get(period.led, 0) + full_ns
        return lit

    def close(self) -> None:
        """Close the file."""
        self._map.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _periods(self) -> tuple[tuple[LitPeriod, ...], int]:
        """Return the lit periods in the ring, and the number of all lit periods so far."""
        data, (_, lit, _) = self._snapshot(_BOARD_COUNTERS, _BOARD_AT)
        periods = tuple(
            LitPeriod(led, start_ns, end_ns, FULL_LEVEL - dimming)
            for led, dimming, start_ns, end_ns in _ring(data, _PERIOD, _PERIODS_AT, lit)
        )
        return periods, lit

    def _snapshot(self, counters: struct.Struct, at: int) -> tuple[bytes, tuple[int, ...]]:
        """Return a copy of the file without a partial change of this writer."""
        ends_s = clock.monotonic() + _WRITER_PATIENCE_S
        while True:
            data = self._map[:]
            counts = counters.unpack_from(data, at)
            if counts[0] % 2 == 0 and counters.unpack_from(self._map, at)[0] == counts[0]:
                return data, counts
            # The writer died in the middle of a change: waiting longer is useless.
            if clock.monotonic() > ends_s:
                return data, counts


def _ring(data: bytes, item: struct.Struct, at: int, count: int) -> list[tuple[int, ...]]:
    numbers = range(max(0, count - RING), count)
    return [item.unpack_from(data, at + k % RING * item.size) for k in numbers]


def _period_at(number: int) -> int:
    return _PERIODS_AT + number % RING * _PERIOD.size


def _trigger_at(number: int) -> int:
    return _TRIGGERS_AT + number % RING * _PAIR.size
