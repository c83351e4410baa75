"""What can go wrong between the wire and the LEDs of the virtual board."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

from pydantic import BaseModel, ConfigDict, TypeAdapter

from rig import Command, LineError, decode_command, encode_command
from simulator._board_firmware import BoardFirmware

_MS = 1_000_000
# Bytes no decoder can make sense of, a line, and half a reply that spoils the one after it.
_BANNER = b"\xff\x00\x80boot: LED board r3\r\n<0000 OK I"


class PowerCutError(Exception):
    """The board is to vanish now."""


class BoardFault(BaseModel):
    """One thing that goes wrong.

    Parameters
    ----------
    kind
        drop-command, drop-reply, corrupt-reply (one bit), delay-reply (by ``value`` ms), banner
        (noise and a boot message before the reply), wrong-led (``value`` is lit instead), goes-dark
        (``value`` ms after ON, in spite of the hold), reset or die (in place of the command).
    verb
        Strikes only commands of this verb; None for any line.
    skip
        How many of them are spared first.
    times
        How many are struck.
    value
        See ``kind``.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: Literal[
        "drop-command",
        "drop-reply",
        "corrupt-reply",
        "delay-reply",
        "banner",
        "wrong-led",
        "goes-dark",
        "reset",
        "die",
    ]
    verb: str | None = None
    skip: int = 0
    times: int = 1
    value: int = 0


BoardFaults = TypeAdapter(tuple[BoardFault, ...])


class FaultyBoard:
    """The firmware behind a line that can be made to fail.

    Parameters
    ----------
    firmware
        What answers.
    """

    def __init__(self, firmware: BoardFirmware) -> None:
        self.firmware = firmware
        self._seen: dict[BoardFault, int] = {}

    def set_faults(self, faults: Iterable[BoardFault]) -> None:
        """Let exactly these faults strike from now on."""
        self._seen = dict.fromkeys(faults, 0)

    def handle(self, line: bytes, now_ns: int) -> tuple[bytes, int]:
        """Act on a line; return the bytes to send back and when to send them.

        Raises
        ------
        PowerCutError
            If a fault says that the board dies.
        """
        command = _command(line)
        fault = self._strike(command)
        kind = None if fault is None else fault.kind
        value = 0 if fault is None else fault.value
        if kind == "die":
            self.firmware.bench.put_out(now_ns)
            raise PowerCutError
        if kind == "drop-command":
            return b"", now_ns
        if kind == "reset":
            self.firmware.boot(now_ns)
            return _BANNER, now_ns
        if kind == "wrong-led" and command is not None:
            swapped = Command(command.seq, command.verb, (str(value), *command.args[1:]))
            line = encode_command(swapped).rstrip()
        reply = self.firmware.handle(line, now_ns) or b""
        if kind == "goes-dark":
            self.firmware.bench.put_out(now_ns + value * _MS)
        elif kind == "drop-reply":
            return b"", now_ns
        elif kind == "corrupt-reply":
            reply = reply[:7] + bytes(b ^ 1 for b in reply[7:8]) + reply[8:]
        elif kind == "banner":
            reply = _BANNER + reply
        elif kind == "delay-reply":
            return reply, now_ns + value * _MS
        return reply, now_ns

    def _strike(self, command: Command | None) -> BoardFault | None:
        striking = None
        for fault, seen in self._seen.items():
            if fault.verb is None or (command is not None and fault.verb == command.verb):
                self._seen[fault] = seen + 1
                if striking is None and fault.skip <= seen < fault.skip + fault.times:
                    striking = fault
        return striking


def _command(line: bytes) -> Command | None:
    try:
        return decode_command(line)
    except LineError:
        return None
