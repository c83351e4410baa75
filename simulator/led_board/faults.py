"""Faults between the host and the LEDs of the virtual board."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Literal, get_args

from rig.board import MAX_COMMAND, Command, LineError, decode_command, decode_reply, encode_command
from simulator.led_board.firmware import BoardFirmware
from simulator.led_board.outputs import BoardOutputs

_MS = 1_000_000
_US = 1000
# Bytes that cannot be decoded, a line, and half a reply that damages the reply after it.
_BANNER = b"\xff\x00\x80boot: LED board r3\r\n<0000 OK I"
_ECHO_US = 300
# Index of the LED among the arguments.
_LED_AT = {"ON": 0, "FLASH": 0, "LEVEL": 0, "STEP": 1}
_OF_TRIGGERS = ("lose-trigger", "double-trigger")


class PowerCutError(Exception):
    """Board disappears now and is back at ``back_ns``, or never (None)."""

    def __init__(self, back_ns: int | None) -> None:
        super().__init__(back_ns)
        self.back_ns = back_ns


FaultKind = Literal[
    "drop-command",
    "double-command",
    "corrupt-command",
    "lose-byte-command",
    "double-byte-command",
    "drop-reply",
    "double-reply",
    "corrupt-reply",
    "lose-byte-reply",
    "double-byte-reply",
    "delay-reply",
    "banner",
    "wrong-led",
    "double-led",
    "goes-dark",
    "reset",
    "reset-after",
    "boot-loader",
    "die",
    "hang-up",
    "lose-trigger",
    "double-trigger",
]


@dataclass(frozen=True, kw_only=True)
class BoardFault:
    """One fault of the board or its line.

    Parameters
    ----------
    kind
        On the way to the board: drop-command, double-command, corrupt-command (one bit),
        lose-byte-command, double-byte-command. On the way back: drop-reply, double-reply,
        corrupt-reply, lose-byte-reply, double-byte-reply, delay-reply (by ``value`` ms), banner
        (noise and a boot message before the reply). A bit or byte fault affects byte ``value``
        (modulo the length) of the line with its line end.

        In the board: wrong-led (LED ``value`` is on, or loaded, instead), double-led (LED
        ``value`` is on as well), goes-dark (the LED turns off ``value`` ms after the command,
        before its declared end), reset (in the middle of the command), reset-after (between acting
        and replying), boot-loader (resets instead of acting, and is silent for ``value`` ms), die
        (disappears instead of acting), hang-up (the same, but is back on the same path after
        ``value`` ms), lose-trigger, double-trigger (a second pulse ``value`` us after the first,
        0 for 300).
    verb
        Verb of the commands that are affected; None for any line. Trigger faults count pulses
        instead of commands.
    skip
        Number of commands or pulses before the first affected one.
    times
        Number of commands or pulses that are affected.
    value
        See ``kind``.

    Raises
    ------
    ValueError
        If the kind is not one of these.
    """

    kind: FaultKind
    verb: str | None = None
    skip: int = 0
    times: int = 1
    value: int = 0

    def __post_init__(self) -> None:
        # Without pydantic, which would take most of the time in which a board starts.
        if self.kind not in get_args(FaultKind):
            raise ValueError(f"a board has no fault {self.kind!r}")


def faults_to_json(faults: Iterable[BoardFault]) -> bytes:
    """Return the line that passes faults to the board's process, without the line end."""
    return json.dumps([asdict(fault) for fault in faults]).encode()


def faults_from_json(line: bytes) -> tuple[BoardFault, ...]:
    """Return the faults of a line.

    Raises
    ------
    TypeError, ValueError
        If the line is not a list of faults.
    """
    return tuple(BoardFault(**fault) for fault in json.loads(line))


class FaultyBoard:
    """Board with faults, including faults of its line.

    Time is an argument; no method sleeps or reads a clock.

    Parameters
    ----------
    firmware
        Firmware of the board.
    outputs
        Outputs that the firmware drives.
    """

    def __init__(self, firmware: BoardFirmware, outputs: BoardOutputs) -> None:
        self.firmware = firmware
        self._outputs = outputs
        outputs.wire = self._pulses
        self._seen: dict[BoardFault, int] = {}
        # Start of a line whose end has not arrived.
        self._piece = b""
        # Faults of future replies; replies in transit with their time of arrival.
        self._reply_faults: list[tuple[Command, BoardFault]] = []
        self._due: list[tuple[int, bytes]] = []
        # Time at which the boot loader starts the firmware; None if the firmware is running.
        self._starts_ns: int | None = None

    def set_faults(self, faults: Iterable[BoardFault]) -> None:
        """Replace the faults."""
        self._seen = dict.fromkeys(faults, 0)
        self._reply_faults.clear()

    def add_fault(self, fault: BoardFault) -> None:
        """Add a fault, which applies to the commands sent from now on."""
        self._seen[fault] = 0

    def receive(self, data: bytes, now_ns: int) -> None:
        """Receive bytes from the host.

        Raises
        ------
        PowerCutError
            If a fault makes the board disappear.
        """
        self._start(now_ns)
        if self._starts_ns is not None:
            return
        *lines, piece = (self._piece + data).split(b"\n")
        # A longer piece is too long for a command, so noise does not accumulate.
        self._piece = piece[: MAX_COMMAND + 2]
        for line in lines:
            text = line.removesuffix(b"\r")
            command = _command(text)
            # Faults apply only to lines that the firmware would decode.
            fault = self._strike(command) if 0 < len(text) <= MAX_COMMAND else None
            self._take(line, command, fault, now_ns)

    def reset(self, now_ns: int) -> None:
        """Restart the firmware; data in transit in either direction is lost."""
        self.firmware.boot(now_ns)
        self._piece = b""
        self._due.clear()

    def advance(self, now_ns: int) -> bytes:
        """Carry out all actions that are due, and return the bytes that arrive at the host."""
        self._start(now_ns)
        self._reply(self.firmware.advance(now_ns), now_ns)
        arrived = sorted((item for item in self._due if item[0] <= now_ns), key=lambda i: i[0])
        self._due = [item for item in self._due if item[0] > now_ns]
        return b"".join(reply for _, reply in arrived)

    def next_ns(self, now_ns: int) -> int:
        """Return the time at which `advance` is due again."""
        starts = [] if self._starts_ns is None else [self._starts_ns]
        due = [at for at, _ in self._due]
        return min([self.firmware.light.next_ns(now_ns), *due, *starts])

    def _start(self, now_ns: int) -> None:
        if self._starts_ns is not None and now_ns >= self._starts_ns:
            self.firmware.boot(self._starts_ns)
            self._starts_ns = None

    def _take(
        self, line: bytes, command: Command | None, fault: BoardFault | None, now_ns: int
    ) -> None:
        kind = "" if fault is None else fault.kind
        value = 0 if fault is None else fault.value
        if kind in ("die", "hang-up"):
            self._outputs.put_out(now_ns)
            self._due.clear()
            raise PowerCutError(None if kind == "die" else now_ns + value * _MS)
        if kind == "boot-loader":
            self.reset(now_ns)
            self._starts_ns = now_ns + value * _MS
            return
        if kind == "reset":
            self.firmware.boot(now_ns)
            self._due = [(now_ns, _BANNER)]
            line = line[len(line) // 2 :]
        elif kind == "wrong-led" and command is not None and command.verb in _LED_AT:
            at = _LED_AT[command.verb]
            words = *command.args[:at], str(value), *command.args[at + 1 :]
            line = encode_command(Command(command.seq, command.verb, words)).rstrip()
        if fault is not None and command is not None and kind.endswith(("reply", "banner")):
            self._reply_faults.append((command, fault))
        if kind == "double-led":
            self._outputs.double_led = value
        received = _damaged(line + b"\n", kind, value, "command")
        self._reply(self.firmware.receive(received, now_ns), now_ns)
        self._outputs.double_led = None
        if kind == "goes-dark":
            self.firmware.light.fail(now_ns + value * _MS)
        if kind == "reset-after":
            self.firmware.boot(now_ns)
            self._due = [(now_ns, _BANNER)]

    def _reply(self, replies: bytes, now_ns: int) -> None:
        for line in replies.splitlines(keepends=True):
            reply = decode_reply(line.rstrip())
            kind, value = "", 0
            for item in self._reply_faults:
                command, fault = item
                if (command.seq, command.verb) == (reply.seq, reply.verb):
                    kind, value = fault.kind, fault.value
                    self._reply_faults.remove(item)
                    break
            sent = _damaged(line, kind, value, "reply")
            if kind == "banner":
                sent = _BANNER + sent
            at_ns = now_ns + value * _MS if kind == "delay-reply" else now_ns
            self._due.append((at_ns, sent))

    def _pulses(self, time_ns: int) -> tuple[int, ...]:
        fault = self._strike_of(fault for fault in self._seen if fault.kind in _OF_TRIGGERS)
        if fault is None:
            return (time_ns,)
        if fault.kind == "lose-trigger":
            return ()
        return time_ns, time_ns + (fault.value or _ECHO_US) * _US

    def _strike(self, command: Command | None) -> BoardFault | None:
        verb = None if command is None else command.verb
        return self._strike_of(
            fault
            for fault in self._seen
            if fault.kind not in _OF_TRIGGERS and fault.verb in (None, verb)
        )

    def _strike_of(self, concerned: Iterable[BoardFault]) -> BoardFault | None:
        striking = None
        for fault in tuple(concerned):
            seen = self._seen[fault]
            self._seen[fault] = seen + 1
            if striking is None and fault.skip <= seen < fault.skip + fault.times:
                striking = fault
        return striking


def _damaged(line: bytes, kind: str, value: int, way: str) -> bytes:
    """Return the bytes that arrive of a line with its line end."""
    at = value % len(line)
    if kind == f"drop-{way}":
        return b""
    if kind == f"double-{way}":
        return line + line
    if kind == f"corrupt-{way}":
        return line[:at] + bytes((line[at] ^ 1,)) + line[at + 1 :]
    if kind == f"lose-byte-{way}":
        return line[:at] + line[at + 1 :]
    if kind == f"double-byte-{way}":
        return line[:at] + line[at : at + 1] + line[at:]
    return line


def _command(line: bytes) -> Command | None:
    try:
        return decode_command(line)
    except LineError:
        return None
