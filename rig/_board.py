"""The LED board as the host sees it: a client over pyserial."""

from __future__ import annotations

import secrets
import time
from dataclasses import dataclass

import serial

from rig._errors import BoardError
from rig._protocol import (
    BAUD_RATE,
    NO_LED,
    PROTOCOL_VERSION,
    SEQUENCE_NUMBERS,
    Command,
    ErrorCode,
    LineBuffer,
    LineError,
    Reply,
    decode_reply,
    encode_command,
)

# An unplugged port shows as any of these; SerialException is an OSError.
try:
    import termios

    _LINE_FAILURES: tuple[type[Exception], ...] = (OSError, termios.error)
except ImportError:  # Windows
    _LINE_FAILURES = (OSError,)
_OPEN_FAILURES: tuple[type[Exception], ...] = (*_LINE_FAILURES, ValueError)

REPLY_TIMEOUT_S = 0.25
ATTEMPTS = 3
OFF_ATTEMPTS = 8
# How long an ON and the OFF after it may take at worst.
ON_OFF_TIMEOUT_S = (ATTEMPTS + OFF_ATTEMPTS) * REPLY_TIMEOUT_S
# A board that resets when its port opens may sit in its boot loader for two seconds.
HANDSHAKE_TIMEOUT_S = 4.0


@dataclass(frozen=True)
class BoardIdentity:
    """Who answered on the port.

    Parameters
    ----------
    name
        The firmware's name.
    protocol
        Version of the serial protocol.
    firmware
        Version of the firmware.
    leds
        How many LEDs the board drives; they count from 0.
    max_hold_ms
        Longest time for which the board keeps an LED on.
    """

    name: str
    protocol: int
    firmware: str
    leds: int
    max_hold_ms: int


@dataclass(frozen=True)
class BoardEcho:
    """What the board said it did.

    Parameters
    ----------
    seq
        Sequence number of the command.
    led
        The LED acted on. Of an OFF: the LED that burned until now, None where all were dark.
    """

    seq: int
    led: int | None


@dataclass(frozen=True)
class BoardStatus:
    """How the board is.

    Parameters
    ----------
    uptime_ms
        Time since the board started; a small value betrays a reset.
    led
        The LED that burns, None where all are dark.
    faults
        Damaged lines received since the board started.
    """

    uptime_ms: int
    led: int | None
    faults: int


class Board:
    """An open LED board.

    A command whose reply does not come is sent again under the same sequence number. The board
    answers such a repetition without acting twice, so no repeat can light an LED again.

    Parameters
    ----------
    port
        Device path of the serial port.
    handshake_timeout_s
        How long the board may take to say who it is; it may still be starting.

    Raises
    ------
    BoardError
        If the port is absent or busy, nobody answers, or what answers is no board of this
        protocol version.
    """

    def __init__(self, port: str, *, handshake_timeout_s: float = HANDSHAKE_TIMEOUT_S) -> None:
        self.port = port
        self._lines = LineBuffer()
        self._unread: list[bytes] = []
        self._rejected = b""
        # A random start keeps the late replies of an earlier program from fitting.
        self._seq = secrets.randbelow(SEQUENCE_NUMBERS)
        try:
            self._serial = serial.Serial(
                port, BAUD_RATE, timeout=REPLY_TIMEOUT_S, write_timeout=1.0, exclusive=True
            )
        except _OPEN_FAILURES as error:
            raise BoardError(
                f"LED board on {port}: the port cannot be opened ({error}); check the cable, "
                "the name, your permissions and that no other program uses it"
            ) from error
        try:
            self.identity = self._handshake(handshake_timeout_s)
        except BaseException as error:
            try:
                self.close()
            except BoardError as failure:
                error.add_note(f"on closing: {failure}")
            raise

    def on(self, led: int, hold_ms: int) -> BoardEcho:
        """Light exactly this LED; the board itself turns it off after ``hold_ms``.

        Raises
        ------
        BoardError
            If the board does not answer, refuses, or lit another LED or for another time.
        """
        reply = self._ask("ON", str(led), str(hold_ms))
        lit, held_ms = self._number(reply, 0), self._number(reply, 1)
        if (lit, held_ms) != (led, hold_ms):
            raise BoardError(
                f"{self._where('ON', (str(led),))}: for {hold_ms} ms was asked, the board lit LED "
                f"{lit} for {held_ms} ms; check its firmware"
            )
        return BoardEcho(reply.seq, lit)

    def off(self) -> BoardEcho:
        """Turn all LEDs off, trying hard, and say which one burned until now.

        Raises
        ------
        BoardError
            If the board does not confirm it; its own hold limit then ends the light.
        """
        reply = self._ask("OFF", attempts=OFF_ATTEMPTS)
        return BoardEcho(reply.seq, self._led(reply, 0))

    def status(self) -> BoardStatus:
        """Ask how the board is.

        Raises
        ------
        BoardError
            If the board does not answer.
        """
        reply = self._ask("STATUS")
        return BoardStatus(self._number(reply, 0), self._led(reply, 1), self._number(reply, 2))

    def close(self) -> None:
        """Give the port back. LEDs are left as they are: their hold ends by itself."""
        try:
            self._serial.close()
        except _LINE_FAILURES as error:
            raise BoardError(f"LED board on {self.port}: closing failed ({error})") from error

    def _handshake(self, timeout_s: float) -> BoardIdentity:
        try:
            self._serial.reset_input_buffer()
            # Ends whatever an earlier program left half sent.
            self._serial.write(b"\n")
        except _LINE_FAILURES as error:
            raise self._lost("ID", error) from error
        reply = self._ask("ID", attempts=max(1, round(timeout_s / REPLY_TIMEOUT_S)))
        words = reply.args
        # Name and version come first in every version of the protocol.
        if len(words) < 2 or words[1] != str(PROTOCOL_VERSION):
            raise BoardError(
                f"LED board on {self.port} speaks protocol {' '.join(words[1:2]) or '?'}, this "
                f"software speaks {PROTOCOL_VERSION}: update the firmware or the software"
            )
        firmware = words[2] if len(words) > 2 else "?"
        return BoardIdentity(
            words[0], PROTOCOL_VERSION, firmware, self._number(reply, 3), self._number(reply, 4)
        )

    def _ask(self, verb: str, *args: str, attempts: int = ATTEMPTS) -> Reply:
        self._seq = (self._seq + 1) % SEQUENCE_NUMBERS
        line = encode_command(Command(self._seq, verb, args))
        where = self._where(verb, args)
        self._rejected = b""
        for _ in range(attempts):
            try:
                self._serial.write(line)
                reply = self._await(verb)
            except _LINE_FAILURES as error:
                raise self._lost(verb, error, args) from error
            if reply is not None:
                break
        else:
            talk = f"; it does send {self._rejected[:40]!r}" if self._rejected else ""
            raise BoardError(
                f"{where}: no answer within {attempts * REPLY_TIMEOUT_S:g} s{talk}; check power, "
                "cable, and that this port is the LED board's"
            )
        if reply.error is not None:
            raise BoardError(f"{where}: the board refused, {_reason(reply.error)}")
        return reply

    def _await(self, verb: str) -> Reply | None:
        """Return the reply to the current command, dropping what is damaged or answers others."""
        deadline = time.monotonic() + REPLY_TIMEOUT_S
        while True:
            while self._unread:
                line = self._unread.pop(0)
                try:
                    reply = decode_reply(line)
                except LineError:
                    self._rejected = line
                    continue
                if reply.seq == self._seq and reply.verb == verb:
                    return reply
            left_s = deadline - time.monotonic()
            if left_s <= 0:
                return None
            self._serial.timeout = left_s
            data = self._serial.read(1)
            data += self._serial.read(self._serial.in_waiting)
            self._unread += self._lines.feed(data)

    def _where(self, verb: str, args: tuple[str, ...]) -> str:
        led = f" LED {args[0]}" if args else ""
        return f"LED board on {self.port}, {verb}{led}"

    def _lost(self, verb: str, error: Exception, args: tuple[str, ...] = ()) -> BoardError:
        return BoardError(
            f"{self._where(verb, args)}: the line is lost ({error}); was the board unplugged?"
        )

    def _number(self, reply: Reply, index: int) -> int:
        try:
            return int(reply.args[index])
        except (IndexError, ValueError):
            raise BoardError(
                f"{self._where(reply.verb, ())}: a reply that makes no sense "
                f"({' '.join(reply.args)}); check the firmware"
            ) from None

    def _led(self, reply: Reply, index: int) -> int | None:
        return None if reply.args[index : index + 1] == (NO_LED,) else self._number(reply, index)


def _reason(error: int) -> str:
    try:
        text = ErrorCode(error).name.lower().replace("_", " ")
    except ValueError:
        text = "for a reason this software does not know"
    return f"error {error}: {text}"
