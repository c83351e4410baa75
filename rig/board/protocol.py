"""Encoding and decoding of the serial protocol's lines, as docs/serial-protocol.md specifies.

Pure functions, used by both the client and the virtual board.
"""

from __future__ import annotations

import binascii
import re
from dataclasses import dataclass
from enum import IntEnum

PROTOCOL_VERSION = 2
BAUD_RATE = 115200
# Longest lines in bytes, without the line end. A refusal is 3 bytes longer than its command.
MAX_COMMAND = 64
MAX_REPLY = 80
SEQUENCE_NUMBERS = 0x10000
NO_LED = "-"

_FRAME = re.compile(
    rb"(?P<body>(?P<mark>[<>])(?P<seq>[0-9A-F]{4})(?P<words>(?: [!-)+-~]+)+))\*(?P<crc>[0-9A-F]{4})"
)


class LineError(Exception):
    """A line is not a complete, undamaged line of this protocol."""


class ErrorCode(IntEnum):
    """Reasons for which a board refuses a command."""

    UNKNOWN_COMMAND = 1
    BAD_ARGUMENTS = 2
    NO_SUCH_LED = 3
    BAD_TIME = 4
    BUSY = 5
    NO_SUCH_LEVEL = 6
    NO_SUCH_STEP = 7


@dataclass(frozen=True)
class Command:
    """A command from the host.

    Parameters
    ----------
    seq
        Sequence number, 0 to 65535.
    verb
        Name of the command, for instance ON.
    args
        Words without spaces or ``*``.
    """

    seq: int
    verb: str
    args: tuple[str, ...] = ()


@dataclass(frozen=True)
class Reply:
    """A reply of the board: the command's sequence number and verb, and the outcome.

    Parameters
    ----------
    seq
        Sequence number of the command.
    verb
        Verb of the command.
    args
        The outcome; for a refused command, its arguments.
    error
        None, or the number of the refusal (see `ErrorCode`; later boards may have more).
    """

    seq: int
    verb: str
    args: tuple[str, ...] = ()
    error: int | None = None


def crc16(data: bytes) -> int:
    """Return the CRC-16/CCITT-FALSE: polynomial 0x1021, initial value 0xFFFF, no reflection.

    Examples
    --------
    >>> from rig.board import crc16
    >>> hex(crc16(b"123456789"))
    '0x29b1'
    """
    return binascii.crc_hqx(data, 0xFFFF)


def encode_command(command: Command) -> bytes:
    r"""Return the command as a line with its line end.

    Examples
    --------
    >>> from rig.board import Command, encode_command
    >>> encode_command(Command(7, "ON", ("3",)))
    b'>0007 ON 3*CD74\n'
    """
    return _encode(b">", MAX_COMMAND, command.seq, (command.verb, *command.args))


def encode_reply(reply: Reply) -> bytes:
    r"""Return the reply as a line with its line end.

    Examples
    --------
    >>> from rig.board import Reply, encode_reply
    >>> encode_reply(Reply(7, "ON", ("3",)))
    b'<0007 OK ON 3*62C1\n'
    """
    status = "OK" if reply.error is None else f"E{reply.error}"
    return _encode(b"<", MAX_REPLY, reply.seq, (status, reply.verb, *reply.args))


def decode_command(line: bytes) -> Command:
    """Parse a line (without its line end) as a command.

    Raises
    ------
    LineError
        If the line is damaged or not a command.

    Examples
    --------
    >>> from rig.board import Command, decode_command, encode_command
    >>> line = encode_command(Command(7, "ON", ("3",)))
    >>> decode_command(line.strip())
    Command(seq=7, verb='ON', args=('3',))
    """
    seq, words = _decode(b">", MAX_COMMAND, line)
    return Command(seq, words[0], tuple(words[1:]))


def decode_reply(line: bytes) -> Reply:
    """Parse a line (without its line end) as a reply.

    Raises
    ------
    LineError
        If the line is damaged or not a reply.

    Examples
    --------
    >>> from rig.board import Reply, decode_reply, encode_reply
    >>> line = encode_reply(Reply(7, "ON", ("3",)))
    >>> decode_reply(line.strip())
    Reply(seq=7, verb='ON', args=('3',), error=None)
    """
    seq, words = _decode(b"<", MAX_REPLY, line)
    status, verb, args = words[0], words[1:2], tuple(words[2:])
    refused = re.fullmatch("E([1-9][0-9]{0,3})", status)
    if not verb or (status != "OK" and refused is None):
        raise LineError(f"not a reply: {line!r}")
    return Reply(seq, verb[0], args, int(refused[1]) if refused else None)


class LineBuffer:
    """Assembles lines from the pieces that a serial port delivers.

    Parameters
    ----------
    limit
        Longest line that is kept, in bytes without the line end.
    """

    def __init__(self, limit: int = MAX_REPLY) -> None:
        self._limit = limit
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Return the lines that ``data`` completes, without line ends and without overlong ones."""
        *lines, rest = (self._rest + data).split(b"\n")
        # A piece this long is still too long when its line end arrives, so noise does not pile up.
        self._rest = rest[: self._limit + 2]
        stripped = [line.removesuffix(b"\r") for line in lines]
        return [line for line in stripped if 0 < len(line) <= self._limit]


def _encode(mark: bytes, limit: int, seq: int, words: tuple[str, ...]) -> bytes:
    body = mark + f"{seq:04X} {' '.join(words)}".encode("ascii")
    line = body + f"*{crc16(body):04X}".encode("ascii")
    valid = _FRAME.fullmatch(line) is not None and len(line.split(b" ")) == len(words) + 1
    if not valid or len(line) > limit:
        raise LineError(f"cannot be sent as one line of {limit} characters: {line!r}")
    return line + b"\n"


def _decode(mark: bytes, limit: int, line: bytes) -> tuple[int, list[str]]:
    match = _FRAME.fullmatch(line)
    if match is None or match["mark"] != mark or len(line) > limit:
        raise LineError(f"not a line of the protocol: {line!r}")
    if int(match["crc"], 16) != crc16(match["body"]):
        raise LineError(f"wrong checksum: {line!r}")
    return int(match["seq"], 16), match["words"].decode("ascii").split()
