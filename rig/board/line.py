"""The serial line to the LED board: sends commands and returns their replies."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

from rig._errors import BoardError
from rig.board.protocol import (
    BAUD_RATE,
    SEQUENCE_NUMBERS,
    Command,
    LineBuffer,
    LineError,
    Reply,
    decode_reply,
    encode_command,
)
from rig.board.replies import Outcome, lost, overtaken, silent
from rig.host import clock, filesystem, lines, program

# An unplugged port raises any of these; SerialException is an OSError.
try:
    import termios

    _LINE_FAILURES: tuple[type[Exception], ...] = (OSError, termios.error)
except ImportError:  # Windows
    _LINE_FAILURES = (OSError,)
# pyserial refuses some names with a ValueError, and reads from a closed port with a TypeError.
_OPEN_FAILURES: tuple[type[Exception], ...] = (*_LINE_FAILURES, ValueError)
_DARKEN_FAILURES: tuple[type[Exception], ...] = (*_LINE_FAILURES, ValueError, TypeError)

REPLY_TIMEOUT_S = 0.25
# A simulated board on a busy computer may take a second to answer; its LED is safe meanwhile.
ATTEMPTS = 8
_WRITE_TIMEOUT_S = 1.0


@dataclass
class _Begun:
    """A long-running command, when it was sent, and how often `darken` had been called by then."""

    command: Command
    lasts_s: float
    began_s: float
    darkened: int
    reply: Reply | None = None


class BoardLine:
    """An open serial port that sends commands and repeats them until they are answered.

    A repetition has the same sequence number, so that the board does not act twice. Only `darken`
    may be called from other threads.

    Parameters
    ----------
    port
        Device path of the serial port.

    Raises
    ------
    BoardError
        If the port is absent or busy.
    """

    def __init__(self, port: str) -> None:
        self.port = port
        self._lines = LineBuffer()
        self._unread: list[bytes] = []
        self._rejected = b""
        # With a random start, late replies to an earlier program do not match.
        self._seq = program.draw_below(SEQUENCE_NUMBERS)
        self._begun: _Begun | None = None
        self._darkened = 0
        self._closing = False
        try:
            self._serial = lines.open_line(
                port,
                BAUD_RATE,
                timeout=REPLY_TIMEOUT_S,
                write_timeout=_WRITE_TIMEOUT_S,
                exclusive=True,
            )
        except _OPEN_FAILURES as error:
            raise BoardError(
                f"LED board on {port}: the port cannot be opened ({error}); check the cable, "
                "the name, your permissions, and that no other program uses it"
            ) from error

    def clear(self) -> None:
        """Discard all received bytes, and end a line that an earlier program left half sent.

        Raises
        ------
        BoardError
            If the connection is lost.
        """
        try:
            self._serial.reset_input_buffer()
            self._serial.write(b"\n")
        except _LINE_FAILURES as error:
            raise lost(self.port, Command(0, "ID"), error) from error

    def ask(self, verb: str, *args: str, attempts: int = ATTEMPTS) -> Outcome:
        """Send a command until it is answered, and return the answer, which may be a refusal.

        Raises
        ------
        BoardError
            If the connection is lost, there is no answer, or `darken` was called meanwhile.
        """
        command, darkened = self._next(verb, args), self._darkened
        for attempt in range(attempts):
            self._send(command, darkened)
            reply = self._await(command, REPLY_TIMEOUT_S)
            if reply is not None:
                return Outcome(self.port, command, reply, again=attempt > 0)
        raise silent(self.port, command, attempts * REPLY_TIMEOUT_S, self._rejected)

    def begin(self, lasts_s: float, verb: str, *args: str) -> None:
        """Send a command that is answered after some time; others may be sent meanwhile.

        Parameters
        ----------
        lasts_s
            How long the board takes to carry it out.
        verb, args
            The command.

        Raises
        ------
        BoardError
            If the connection is lost.
        """
        command = self._next(verb, args)
        self._begun = _Begun(command, lasts_s, clock.monotonic(), self._darkened)
        self._send(command, self._begun.darkened)

    def begun(self) -> Outcome | None:
        """Return the answer to the pending command, if it has been read already."""
        if self._begun is None or self._begun.reply is None:
            return None
        return Outcome(self.port, self._begun.command, self._begun.reply)

    def finish(self) -> Outcome:
        """Return the answer to the pending command; send the command again if none arrives.

        Raises
        ------
        BoardError
            As `ask`.
        """
        begun, self._begun = self._begun, None
        if begun is None:
            raise BoardError(f"LED board on {self.port}: no command is pending; begin one first")
        timeout_s = begun.lasts_s + REPLY_TIMEOUT_S
        left_s = begun.began_s + timeout_s - clock.monotonic()
        reply = begun.reply or self._await(begun.command, left_s)
        again = reply is None
        for _ in range(ATTEMPTS - 1):
            if reply is None:
                # A board that has not received it yet takes the full time from now.
                self._send(begun.command, begun.darkened)
                reply = self._await(begun.command, timeout_s)
        if reply is None:
            raise silent(self.port, begun.command, ATTEMPTS * timeout_s, self._rejected)
        return Outcome(self.port, begun.command, reply, again=again)

    def abandon(self) -> None:
        """Stop waiting for the answer to the pending command."""
        self._begun = None

    def darken(self) -> None:
        """Send one OFF immediately, without waiting and without raising.

        It may be called from a signal handler or another thread, between any two steps of the other
        methods. Commands that they were about to send or repeat are no longer sent, except OFF.
        """
        self._darkened += 1
        if self._closing:  # a file may have the number of the port by now
            return
        # A number far from the others: the next regular OFF is then not a repetition of this one,
        # so its reply does not name an LED that this one has turned off.
        apart = (self._seq + SEQUENCE_NUMBERS // 2) % SEQUENCE_NUMBERS
        with contextlib.suppress(*_DARKEN_FAILURES):
            # The line end in front ends a half-written command.
            self._write_now(b"\n" + encode_command(Command(apart, "OFF")))

    def close(self) -> None:
        """Close the port.

        Raises
        ------
        BoardError
            If closing fails.
        """
        self._closing = True
        try:
            self._serial.close()
        except _LINE_FAILURES as error:
            raise BoardError(f"LED board on {self.port}: closing failed ({error})") from error

    def _next(self, verb: str, args: tuple[str, ...]) -> Command:
        self._seq = (self._seq + 1) % SEQUENCE_NUMBERS
        self._rejected = b""
        return Command(self._seq, verb, args)

    def _send(self, command: Command, darkened: int) -> None:
        if command.verb != "OFF" and darkened != self._darkened:
            raise overtaken(self.port, command)
        try:
            self._serial.write(encode_command(command))
        except _LINE_FAILURES as error:
            raise lost(self.port, command, error) from error
        if command.verb != "OFF" and darkened != self._darkened:
            # The OFF may have been sent before this command.
            self.darken()
            raise overtaken(self.port, command)

    def _await(self, command: Command, timeout_s: float) -> Reply | None:
        """Return the reply to a command; discard damaged lines and replies to other commands."""
        deadline = clock.monotonic() + timeout_s
        late = False
        while True:
            while self._unread:
                reply = self._read(self._unread.pop(0))
                if reply is not None and _answers(reply, command):
                    return reply
                if reply is not None and self._begun and _answers(reply, self._begun.command):
                    self._begun.reply = reply
            if late:
                return None
            # After the deadline, bytes that have already arrived are still read, once.
            left_s = deadline - clock.monotonic()
            late = left_s <= 0
            try:
                self._serial.timeout = max(0.0, left_s)
                data = self._serial.read(1)
                data += self._serial.read(self._serial.in_waiting)
            except _LINE_FAILURES as error:
                raise lost(self.port, command, error) from error
            self._unread += self._lines.feed(data)

    def _read(self, line: bytes) -> Reply | None:
        try:
            return decode_reply(line)
        except LineError:
            self._rejected = line
            return None

    def _write_now(self, data: bytes) -> None:
        fd = getattr(self._serial, "fd", None)
        if fd is None:  # Windows
            self._serial.write(data)
            return
        try:
            filesystem.write(fd, data)
        except BlockingIOError:
            # The board does not read: discard what waits to be sent, this OFF matters more.
            self._serial.reset_output_buffer()
            filesystem.write(fd, data)


def _answers(reply: Reply, command: Command) -> bool:
    return reply.seq == command.seq and reply.verb == command.verb
