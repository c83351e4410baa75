"""The firmware of the virtual board, without a wire or a clock."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rig.board import (
    MAX_COMMAND,
    NO_LED,
    PROTOCOL_VERSION,
    Command,
    ErrorCode,
    LineBuffer,
    LineError,
    Reply,
    Step,
    decode_command,
    encode_reply,
)
from simulator.bench.state import FULL_LEVEL
from simulator.led_board.light import WATCHDOG_NS, BoardLight, FlashRecord
from simulator.led_board.outputs import ActiveInput, BoardOutputs

NAME = "sgp-virtual-board"
FIRMWARE = "2.0.0"
MAX_HOLD_MS = 60_000
MAX_STEPS = 48
_MS = 1_000_000
_MAX_HOLD_US = MAX_HOLD_MS * 1000
_MAX_PAUSE_US = 1_000_000
_MIN_HOLD_US = 10
_WRAPS = 1_000_000_000
_TEMPERATURE_DK = 2982

_Words = tuple[str, ...]
# A number, or None for no LED.
_Argument = int | None
_PACES = {"T": 0, "A": 1}


class _RefusedError(Exception):
    """Command is refused with this `ErrorCode`."""


@dataclass(frozen=True)
class _Verb:
    """Arguments and action of a command.

    ``arguments`` has a letter for each argument: n number, l LED or no LED, p pace. ``act`` returns
    the words of the reply, or None if the reply is sent later. ``query``: the command
    changes nothing. ``refused``: it is refused while a flash or a sequence runs.
    """

    arguments: str
    act: Callable[..., _Words | None]
    query: bool = False
    refused: bool = False


class BoardFirmware:
    """The board of docs/serial-protocol.md as a state machine.

    Parameters
    ----------
    leds
        Number of LEDs.
    outputs, active
        Outputs and exposure-active input.
    now_ns
        Monotonic time at power-on.
    """

    def __init__(self, leds: int, outputs: BoardOutputs, active: ActiveInput, now_ns: int) -> None:
        self.leds = leds
        self._outputs = outputs
        self._active = active
        self._verbs = {
            "ID": _Verb("", self._id, query=True),
            "STATUS": _Verb("", self._status, query=True),
            "DID": _Verb("n", self._did, query=True),
            "OFF": _Verb("", self._off),
            "ON": _Verb("nn", self._on, refused=True),
            "LEVEL": _Verb("nn", self._level, refused=True),
            "FLASH": _Verb("lnn", self._flash, refused=True),
            "STEP": _Verb("nlnnn", self._step, refused=True),
            "RUN": _Verb("np", self._run, refused=True),
        }
        self.boot(now_ns)

    def boot(self, now_ns: int) -> None:
        """Restart with all LEDs off and the initial state."""
        self.light = BoardLight(self.leds, self._outputs, self._active, now_ns)
        self._lines = LineBuffer(MAX_COMMAND)
        self._now_ns = self._boot_ns = now_ns
        self._faults = 0
        # The last command that was carried out or refused; its reply, None if not yet known.
        self._last: tuple[Command, bytes | None] | None = None
        self._flashing: Command | None = None

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Receive bytes, carry out the commands that they complete, and return the replies."""
        return b"".join(self._handle(line, now_ns) for line in self._lines.feed(data))

    def _handle(self, line: bytes, now_ns: int) -> bytes:
        """Carry out a line and return the bytes to send; a damaged line is only counted."""
        due = self.advance(now_ns)
        try:
            command = decode_command(line)
        except LineError:
            self._faults += 1
            return due
        self.light.heard(now_ns)
        verb = self._verbs.get(command.verb)
        if verb is not None and verb.query:
            return due + (self._answer(command, verb) or b"")
        # The same command with the same number is a repetition: send the reply again, do not act.
        if self._last is None or self._last[0] != command:
            self._last = command, None
            self._last = command, self._answer(command, verb)
        return due + (self._last[1] or b"")

    def advance(self, now_ns: int) -> bytes:
        """Carry out all actions that are due, and return the reply to a flash that has ended."""
        self._now_ns = now_ns
        record = self.light.advance(now_ns)
        if record is None or self._flashing is None:
            return b""
        command, self._flashing = self._flashing, None
        since = "-" if record.since_us is None else str(record.since_us)
        words = _led_word(record.led), since, *_record_words(record)
        reply = encode_reply(Reply(command.seq, command.verb, words))
        if self._last == (command, None):
            self._last = command, reply
        return reply

    def _answer(self, command: Command, verb: _Verb | None) -> bytes | None:
        try:
            words = self._act(command, verb)
        except _RefusedError as refused:
            reply = Reply(command.seq, command.verb, command.args, int(refused.args[0]))
        else:
            if words is None:
                self._flashing = command
                return None
            reply = Reply(command.seq, command.verb, words)
        return encode_reply(reply)

    def _act(self, command: Command, verb: _Verb | None) -> _Words | None:
        if verb is None:
            raise _RefusedError(ErrorCode.UNKNOWN_COMMAND)
        if len(command.args) != len(verb.arguments):
            raise _RefusedError(ErrorCode.BAD_ARGUMENTS)
        arguments = [_argument(*a) for a in zip(command.args, verb.arguments, strict=True)]
        if verb.refused and self.light.busy:
            raise _RefusedError(ErrorCode.BUSY)
        return verb.act(*arguments)

    def _id(self) -> _Words:
        limits = self.leds, MAX_HOLD_MS, WATCHDOG_NS // _MS, MAX_STEPS
        return NAME, str(PROTOCOL_VERSION), FIRMWARE, *map(str, limits)

    def _status(self) -> _Words:
        uptime_ms = (self._now_ns - self._boot_ns) // _MS % _WRAPS
        return (
            str(uptime_ms),
            _led_word(self.light.led(self._now_ns)),
            str(self._faults),
            str(self.light.trips),
            str(_TEMPERATURE_DK),
            self.light.state,
            str(len(self.light.done)),
        )

    def _did(self, index: int) -> _Words:
        _require(index < len(self.light.done), ErrorCode.NO_SUCH_STEP)
        record = self.light.done[index]
        words = _record_words(record)
        return str(index), _led_word(record.led), str(record.trigger_us % _WRAPS), *words

    def _off(self) -> _Words:
        self._flashing = None
        return (_led_word(self.light.off(self._now_ns)),)

    def _on(self, led: int, hold_ms: int) -> _Words:
        self._require_led(led)
        _require(1 <= hold_ms <= MAX_HOLD_MS, ErrorCode.BAD_TIME)
        self.light.on(led, hold_ms * _MS, self._now_ns)
        return str(led), str(hold_ms)

    def _level(self, led: int, level: int) -> _Words:
        self._require_led(led)
        _require(level <= FULL_LEVEL, ErrorCode.NO_SUCH_LEVEL)
        self.light.levels[led] = level
        self.light.end_halt()
        return str(led), str(level)

    def _flash(self, led: _Argument, settle_us: int, hold_us: int) -> None:
        self._require_led(led)
        _require_times(settle_us, hold_us)
        self.light.flash(led, settle_us, hold_us, self._now_ns)

    def _step(
        self, index: int, led: _Argument, settle_us: int, hold_us: int, gap_us: int
    ) -> _Words:
        _require(index < MAX_STEPS, ErrorCode.NO_SUCH_STEP)
        self._require_led(led)
        _require_times(settle_us, hold_us)
        _require(gap_us <= _MAX_PAUSE_US, ErrorCode.BAD_TIME)
        self.light.steps[index] = Step(led, settle_us, hold_us, gap_us)
        self.light.end_halt()
        return str(index), _led_word(led), str(settle_us), str(hold_us), str(gap_us)

    def _run(self, count: int, pace: int) -> _Words:
        loaded = count > 0 and all(index in self.light.steps for index in range(count))
        _require(count <= MAX_STEPS and loaded, ErrorCode.NO_SUCH_STEP)
        self.light.run(count, pace == _PACES["A"], self._now_ns)
        return (str(count),)

    def _require_led(self, led: _Argument) -> None:
        _require(led is None or led < self.leds, ErrorCode.NO_SUCH_LED)


def _require(holds: bool, code: ErrorCode) -> None:
    if not holds:
        raise _RefusedError(code)


def _require_times(settle_us: int, hold_us: int) -> None:
    in_range = settle_us <= _MAX_PAUSE_US and hold_us >= _MIN_HOLD_US
    _require(in_range and settle_us + hold_us <= _MAX_HOLD_US, ErrorCode.BAD_TIME)


def _argument(word: str, kind: str) -> _Argument:
    if kind == "p" and word in _PACES:
        return _PACES[word]
    if kind == "l" and word == NO_LED:
        return None
    _require(kind != "p" and word.isdecimal() and len(word) <= 9, ErrorCode.BAD_ARGUMENTS)
    return int(word)


def _led_word(led: int | None) -> str:
    return NO_LED if led is None else str(led)


def _record_words(record: FlashRecord) -> _Words:
    if record.active_us is None:
        return str(record.lit_us), NO_LED
    return str(record.lit_us), f"{record.active_us}{'+' if record.cut_off else ''}"
