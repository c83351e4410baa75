"""Parsing of the LED board's replies, and the errors of a failed exchange."""

from __future__ import annotations

from typing import Self

import serial

from rig._errors import BoardError, BoardGoneError
from rig.board.protocol import NO_LED, Command, ErrorCode, Reply

# Index of the LED among the arguments.
_LED_AT = {"ON": 0, "FLASH": 0, "LEVEL": 0, "STEP": 1, "DID": 1}


class Outcome:
    """A reply to a command, with methods that convert its words.

    Parameters
    ----------
    port
        The board's port.
    command
        The command that was sent.
    reply
        The reply to it.
    again
        Whether the command had to be sent again.

    Raises
    ------
    BoardError
        By every method, if a word is missing or invalid.
    """

    def __init__(self, port: str, command: Command, reply: Reply, *, again: bool = False) -> None:
        self.again = again
        self.seq = reply.seq
        self.error = reply.error
        self.words = reply.args
        self._port = port
        self._command = command

    def done(self) -> Self:
        """Return the outcome of a command that was carried out.

        Raises
        ------
        BoardError
            If the board refused it.
        """
        if self.error is not None:
            prefix = where(self._port, self._command)
            raise BoardError(f"{prefix}: the board refused, {_reason(self.error)}")
        return self

    def repeats(self, count: int) -> Self:
        """Return the outcome of a command whose first ``count`` arguments the board repeated.

        Raises
        ------
        BoardError
            If the board reports that it did something else.
        """
        verb, asked = self._command.verb, self._command.args
        if self.words[:count] != asked[:count]:
            raise BoardError(
                f"{where(self._port, self._command)}: the board did {spoken(verb, self.words)} "
                f"instead of {spoken(verb, asked)}; check its firmware"
            )
        return self

    def word(self, index: int) -> str:
        """Return a word as it is."""
        if index >= len(self.words):
            raise self._senseless()
        return self.words[index]

    def number(self, index: int) -> int:
        """Return a word as a number."""
        return self._read(self.word(index))

    def led(self, index: int) -> int | None:
        """Return the LED that a word names, None for no LED."""
        return None if self.word(index) == NO_LED else self.number(index)

    def exposure(self, index: int) -> tuple[int | None, bool]:
        """Return how long the camera exposed, us, and whether it was still exposing at the end."""
        word = self.word(index)
        if word == NO_LED:
            return None, False
        return self._read(word.removesuffix("+")), word.endswith("+")

    def _read(self, digits: str) -> int:
        if not (digits.isdecimal() and len(digits) <= 9):
            raise self._senseless()
        return int(digits)

    def _senseless(self) -> BoardError:
        said = " ".join(self.words)
        return BoardError(
            f"{where(self._port, self._command)}: the reply is invalid ({said}); check the firmware"
        )


def where(port: str, command: Command) -> str:
    """Return the beginning of a message about a command, which names its LED."""
    return f"LED board on {port}, {spoken(command.verb, command.args)}"


def spoken(verb: str, args: tuple[str, ...]) -> str:
    """Return a command or its outcome in words."""
    at = _LED_AT.get(verb, len(args))
    led = [f"LED {word}" if word != NO_LED else "no LED" for word in args[at : at + 1]]
    return " ".join((verb, *args[:at], *led, *args[at + 1 :]))


def lost(port: str, command: Command, error: Exception) -> BoardGoneError:
    """Return the error for a port that fails."""
    prefix = where(port, command)
    if isinstance(error, serial.SerialTimeoutException):
        return BoardGoneError(
            f"{prefix}: no device accepts the data sent ({error}); check that this port is the LED "
            "board's"
        )
    return BoardGoneError(
        f"{prefix}: the connection is lost ({error}); check whether the board was unplugged"
    )


def silent(port: str, command: Command, waited_s: float, heard: bytes) -> BoardGoneError:
    """Return the error for a board that does not answer; ``heard`` is what arrived instead."""
    talk = f", but it sent {heard[:40]!r}" if heard else ""
    return BoardGoneError(
        f"{where(port, command)}: no answer within {waited_s:g} s{talk}; check power, cable, and "
        "that this port is the LED board's"
    )


def overtaken(port: str, command: Command) -> BoardError:
    """Return the error for a command that an emergency OFF has overtaken."""
    return BoardError(
        f"{where(port, command)}: all LEDs were turned off meanwhile; the command is no longer sent"
    )


def _reason(error: int) -> str:
    try:
        text = ErrorCode(error).name.lower().replace("_", " ")
    except ValueError:
        text = "not known to this software"
    return f"error {error}: {text}"
