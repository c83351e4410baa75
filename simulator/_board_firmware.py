"""What the virtual board's firmware does with a line: no wire, no clock of its own."""

from __future__ import annotations

from collections.abc import Callable

from rig import (
    NO_LED,
    PROTOCOL_VERSION,
    Command,
    ErrorCode,
    LineError,
    Reply,
    decode_command,
    encode_reply,
)
from simulator._bench_state import BenchWriter

NAME = "sgp-virtual-board"
FIRMWARE = "1.0.0"
MAX_HOLD_MS = 10_000
_MS = 1_000_000


class BoardFirmware:
    """The board of docs/serial-protocol.md as a state machine.

    Parameters
    ----------
    leds
        How many LEDs there are.
    bench
        Where the light is stated.
    now_ns
        Monotonic time at power-on.
    """

    def __init__(self, leds: int, bench: BenchWriter, now_ns: int) -> None:
        self.leds = leds
        self.bench = bench
        self._verbs: dict[str, Callable[[tuple[int, ...], int], tuple[str, ...] | ErrorCode]] = {
            "ID": self._id,
            "ON": self._on,
            "OFF": self._off,
            "STATUS": self._status,
        }
        self._arguments = {"ID": 0, "ON": 2, "OFF": 0, "STATUS": 0}
        self.boot(now_ns)

    def boot(self, now_ns: int) -> None:
        """Start anew: everything off, nothing remembered."""
        self.bench.put_out(now_ns)
        self._boot_ns = now_ns
        self._faults = 0
        self._last: tuple[Command, bytes] | None = None

    def handle(self, line: bytes, now_ns: int) -> bytes | None:
        """Act on a line and return the reply line; damaged lines are counted and not answered."""
        try:
            command = decode_command(line)
        except LineError:
            self._faults += 1
            return None
        # The same command under the same number is a repetition: answered again, not done again.
        if self._last is not None and self._last[0] == command:
            return self._last[1]
        outcome = self._act(command, now_ns)
        if isinstance(outcome, ErrorCode):
            reply = Reply(command.seq, command.verb, command.args, int(outcome))
        else:
            reply = Reply(command.seq, command.verb, outcome)
        text = encode_reply(reply)
        self._last = (command, text)
        return text

    def _act(self, command: Command, now_ns: int) -> tuple[str, ...] | ErrorCode:
        verb = self._verbs.get(command.verb)
        if verb is None:
            return ErrorCode.UNKNOWN_COMMAND
        plain = all(word.isdecimal() and len(word) <= 9 for word in command.args)
        if not plain or len(command.args) != self._arguments[command.verb]:
            return ErrorCode.BAD_ARGUMENTS
        return verb(tuple(int(word) for word in command.args), now_ns)

    def _id(self, _: tuple[int, ...], now_ns: int) -> tuple[str, ...]:
        return NAME, str(PROTOCOL_VERSION), FIRMWARE, str(self.leds), str(MAX_HOLD_MS)

    def _on(self, args: tuple[int, ...], now_ns: int) -> tuple[str, ...] | ErrorCode:
        led, hold_ms = args
        if led >= self.leds:
            return ErrorCode.NO_SUCH_LED
        if not 1 <= hold_ms <= MAX_HOLD_MS:
            return ErrorCode.BAD_HOLD
        self.bench.light(led, now_ns, now_ns + hold_ms * _MS)
        return str(led), str(hold_ms)

    def _off(self, _: tuple[int, ...], now_ns: int) -> tuple[str, ...]:
        led = self._burning(now_ns)
        self.bench.put_out(now_ns)
        return (led,)

    def _status(self, _: tuple[int, ...], now_ns: int) -> tuple[str, ...]:
        uptime_ms = (now_ns - self._boot_ns) // _MS
        return str(uptime_ms), self._burning(now_ns), str(self._faults)

    def _burning(self, now_ns: int) -> str:
        led = self.bench.led(now_ns)
        return NO_LED if led is None else str(led)
