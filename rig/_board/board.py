"""The LED board as the host sees it: its commands, each with what the board said it did."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Literal

from rig._board.line import ATTEMPTS, REPLY_TIMEOUT_S, BoardLine
from rig._board.protocol import NO_LED, PROTOCOL_VERSION, ErrorCode
from rig._board.replies import Outcome
from rig._board.values import (
    BoardEcho,
    BoardIdentity,
    BoardStatus,
    FlashReport,
    Step,
    StepReport,
)
from rig._errors import BoardError, close_after

# How long an ON and the OFF after it may take at worst.
ON_OFF_TIMEOUT_S = 2 * ATTEMPTS * REPLY_TIMEOUT_S
# A board that resets when its port opens may sit in its boot loader for two seconds.
HANDSHAKE_TIMEOUT_S = 4.0
_UPTIME_WRAPS_MS = 1_000_000_000
_PACES: dict[Literal["time", "exposure"], str] = {"time": "T", "exposure": "A"}
# A ceramic resonator is off by up to 1 %.
_CLOCKS_DIFFER = 0.01
_ZERO_CELSIUS_DK = 2731.5


class Board:
    """An open LED board.

    A command whose reply does not come is sent again under the same sequence number. The board
    answers such a repetition without acting twice, so no repeat can light an LED again. For one
    thread, except `darken`.

    Parameters
    ----------
    port
        Device path of the serial port.
    handshake_timeout_s
        How long the board may take to say who it is; it may still be starting.

    Attributes
    ----------
    identity
        Who answered.

    Raises
    ------
    BoardError
        If the port is absent or busy, nobody answers, or what answers is no board of this
        protocol version. Also by every method: if the line is lost, the board does not answer or
        refuses, or its answer makes no sense.
    """

    def __init__(self, port: str, *, handshake_timeout_s: float = HANDSHAKE_TIMEOUT_S) -> None:
        self.port = port
        self._line = BoardLine(port)
        self._uptime_ms = 0
        self._uptime_asked_s = time.monotonic()
        try:
            self.identity = self._handshake(handshake_timeout_s)
            # A board that resets when its port opens is younger than the open port: only from here
            # on does a clock that is behind mean a restart.
            self.status()
        except BaseException as error:
            close_after(error, self.close)
            raise

    def on(self, led: int, hold_ms: int) -> BoardEcho:
        """Light exactly this LED; the board itself turns it off.

        It goes out ``hold_ms`` after it was lit, or when the board has not heard of the host for
        its watchdog's time: see `ping`.

        Parameters
        ----------
        led
            The LED.
        hold_ms
            1 to the board's ``max_hold_ms``.
        """
        outcome = self._echoed("ON", str(led), str(hold_ms))
        return BoardEcho(outcome.seq, led)

    def off(self) -> BoardEcho:
        """Turn all LEDs off, trying hard, end flash and sequence, and say what burned until now.

        Raises
        ------
        BoardError
            If the board does not confirm it; hold and watchdog then end the light.
        """
        self._line.abandon()
        outcome = self._line.ask("OFF").done()
        return BoardEcho(outcome.seq, outcome.led(0))

    def level(self, led: int, level: int) -> BoardEcho:
        """Set the brightness of an LED from its next lighting on, 0 to 4095."""
        outcome = self._echoed("LEVEL", str(led), str(level))
        return BoardEcho(outcome.seq, led)

    def status(self) -> BoardStatus:
        """Ask how the board is."""
        told = self._line.ask("STATUS").done()
        unknown = told.word(4) == NO_LED
        status = BoardStatus(
            uptime_ms=told.number(0),
            led=told.led(1),
            faults=told.number(2),
            trips=told.number(3),
            temperature_c=None if unknown else round((told.number(4) - _ZERO_CELSIUS_DK) / 10, 2),
            state=told.word(5),
            done=told.number(6),
        )
        self._uptime_ms, self._uptime_asked_s = status.uptime_ms, time.monotonic()
        return status

    def ping(self) -> None:
        """Give the board a sign of life, which keeps its watchdog from acting.

        Due at least every 300 ms while an LED is kept on or a sequence runs.

        Raises
        ------
        BoardError
            Also if the board has restarted since it was asked last, or refused the flash that was
            begun.
        """
        # Asked now at the earliest, so the board's clock has gone on by at least that.
        passed_ms = (time.monotonic() - self._uptime_asked_s) * 1000
        before_ms = self._uptime_ms
        now_ms = self.status().uptime_ms
        wrapped = before_ms + passed_ms * (1 + _CLOCKS_DIFFER) >= _UPTIME_WRAPS_MS
        if now_ms + 2 < before_ms + passed_ms * (1 - _CLOCKS_DIFFER) and not wrapped:
            raise BoardError(
                f"LED board on {self.port} restarted {now_ms} ms ago: what it was doing is lost; "
                "check its supply and cable, then shoot again"
            )
        flash = self._line.begun()
        if flash is not None and flash.error is not None:
            self._line.abandon()
            flash.done()

    def flash(self, led: int | None, settle_us: int, hold_us: int) -> FlashReport:
        """Do a flash with one trigger pulse, and wait for its end: see `begin_flash`."""
        self.begin_flash(led, settle_us, hold_us)
        return self.end_flash()

    def begin_flash(self, led: int | None, settle_us: int, hold_us: int) -> None:
        """Have the board light an LED, pulse the trigger line, and turn the LED off by itself.

        Parameters
        ----------
        led
            The LED, None for a flash in the dark.
        settle_us
            From the light to the pulse, 0 to 1 000 000.
        hold_us
            From the pulse to the end of the light, at least 10.
        """
        lasts_s = (settle_us + hold_us) / 1e6
        self._line.begin(lasts_s, "FLASH", _word(led), str(settle_us), str(hold_us))

    def end_flash(self) -> FlashReport:
        """Wait for the end of the flash that was begun, and return what it did.

        Raises
        ------
        BoardError
            Also if the board may have flashed twice, because it restarted in between.
        """
        told = self._line.finish().done().repeats(1)
        if told.again:
            self.ping()
        since_us = None if told.word(1) == NO_LED else told.number(1)
        active_us, cut_off = told.exposure(3)
        return FlashReport(told.seq, told.led(0), since_us, told.number(2), active_us, cut_off)

    def load(self, steps: Sequence[Step]) -> None:
        """Load a sequence, at most the board's ``max_steps`` long."""
        for index, step in enumerate(steps):
            times = (str(step.settle_us), str(step.hold_us), str(step.gap_us))
            self._echoed("STEP", str(index), _word(step.led), *times)

    def run(self, count: int, pace: Literal["time", "exposure"] = "time") -> BoardEcho:
        """Start the first ``count`` of the loaded steps.

        Parameters
        ----------
        count
            How many steps.
        pace
            "time": every step lasts as declared. "exposure": its light goes out when the camera's
            exposure-active output has risen and fallen, and a step without ends the sequence.
        """
        outcome = self._line.ask("RUN", str(count), _PACES[pace]).done().repeats(1)
        return BoardEcho(outcome.seq, None)

    def did(self, index: int) -> StepReport | None:
        """Ask what a step of the running or last sequence did; None where it has not ended."""
        told = self._line.ask("DID", str(index))
        if told.error == ErrorCode.NO_SUCH_STEP:
            return None
        told.done().repeats(1)
        active_us, cut_off = told.exposure(4)
        return StepReport(index, told.led(1), told.number(2), told.number(3), active_us, cut_off)

    def darken(self) -> None:
        """Send one OFF straight to the port; wait for nothing and raise nothing.

        For emergencies: may be called from a signal handler or another thread, whatever this board
        is being asked just then. A command that is under way is not repeated any more, except OFF.
        """
        self._line.darken()

    def close(self) -> None:
        """Give the port back. LEDs are left as they are: the board ends their light by itself.

        Raises
        ------
        BoardError
            If closing fails.
        """
        self._line.close()

    def _handshake(self, timeout_s: float) -> BoardIdentity:
        self._line.clear()
        told = self._line.ask("ID", attempts=max(1, round(timeout_s / REPLY_TIMEOUT_S))).done()
        # Name and version come first in every version of the protocol.
        version = " ".join(told.words[1:2])
        if version != str(PROTOCOL_VERSION):
            raise BoardError(
                f"LED board on {self.port} speaks protocol {version or '?'}, this software speaks "
                f"{PROTOCOL_VERSION}: update the firmware or the software"
            )
        return BoardIdentity(
            name=told.word(0),
            protocol=PROTOCOL_VERSION,
            firmware=told.word(2),
            leds=told.number(3),
            max_hold_ms=told.number(4),
            watchdog_ms=told.number(5),
            max_steps=told.number(6),
        )

    def _echoed(self, verb: str, *args: str) -> Outcome:
        """Ask for something that the board repeats when it has done it."""
        return self._line.ask(verb, *args).done().repeats(len(args))


def _word(led: int | None) -> str:
    return NO_LED if led is None else str(led)
