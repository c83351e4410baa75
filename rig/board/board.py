"""Client of the LED board: one method per command, which returns what the board reported."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from rig._errors import BoardError, closed_after_errors
from rig.board.line import ATTEMPTS, REPLY_TIMEOUT_S, BoardLine
from rig.board.protocol import NO_LED, PROTOCOL_VERSION, ErrorCode
from rig.board.replies import Outcome
from rig.board.values import (
    BoardEcho,
    BoardIdentity,
    BoardStatus,
    FlashReport,
    Step,
    StepReport,
)
from rig.host import clock

# The longest time that an ON and the OFF after it may take.
ON_OFF_TIMEOUT_S = 2 * ATTEMPTS * REPLY_TIMEOUT_S
# A board that resets when its port opens may stay in its boot loader for two seconds.
HANDSHAKE_TIMEOUT_S = 4.0
_UPTIME_WRAPS_MS = 1_000_000_000
_PACES: dict[Literal["time", "exposure"], str] = {"time": "T", "exposure": "A"}
# A ceramic resonator is off by up to 1 %.
_CLOCKS_DIFFER = 0.01
_ZERO_CELSIUS_DK = 2731.5


class Board:
    """An open LED board.

    A command without a reply is sent again with the same sequence number. The board answers the
    repetition without acting twice, so a repetition cannot light an LED again. Only `darken` may be
    called from other threads.

    Parameters
    ----------
    port
        Device path of the serial port.
    handshake_timeout_s
        How long the board may take to identify itself; it may still be starting.

    Attributes
    ----------
    identity
        Identity of the board that answered.

    Raises
    ------
    BoardError
        If the port is absent or busy, if there is no answer, or if the answer is not from a board
        of this protocol version. Also by every method: if the connection is lost, or the board does
        not answer, refuses, or sends an invalid answer.
    """

    def __init__(self, port: str, *, handshake_timeout_s: float = HANDSHAKE_TIMEOUT_S) -> None:
        self.port = port
        self._line = BoardLine(port)
        self._uptime_ms = 0
        self._uptime_asked_s = clock.monotonic()
        with closed_after_errors(self.close):
            self.identity = self._handshake(handshake_timeout_s)
            # A board that resets when its port opens starts after the port was opened: only from
            # here on does a clock that is behind mean a restart.
            self.status()

    def on(self, led: int, hold_ms: int) -> BoardEcho:
        """Turn on exactly this LED; the board itself turns it off.

        The board turns it off ``hold_ms`` after it was turned on, or when the host has been silent
        for the watchdog time: see `ping`.

        Parameters
        ----------
        led
            Number of the LED.
        hold_ms
            Time in ms, 1 to the board's ``max_hold_ms``.
        """
        outcome = self._echoed("ON", str(led), str(hold_ms))
        if outcome.again:
            # A board that has restarted carries out a repetition that is still on its way, which
            # turns the LED on a second time. All of them arrive before this query.
            lit = self.status().led
            if lit != led:
                raise BoardError(
                    f"LED board on {self.port}: LED {led} was turned on, but "
                    f"{'no LED' if lit is None else f'LED {lit}'} is on: check the board's supply, "
                    "then shoot again"
                )
        return BoardEcho(outcome.seq, led)

    def off(self) -> BoardEcho:
        """Turn all LEDs off, end flash and sequence, and return the LED that was on until now.

        Raises
        ------
        BoardError
            If the board does not confirm it after all attempts; hold and watchdog then turn the LED
            off.
        """
        self._line.abandon()
        outcome = self._line.ask("OFF").done()
        return BoardEcho(outcome.seq, outcome.led(0))

    def level(self, led: int, level: int) -> BoardEcho:
        """Set the brightness of an LED, 0 to 4095, from the next time it is turned on."""
        outcome = self._echoed("LEVEL", str(led), str(level))
        return BoardEcho(outcome.seq, led)

    def status(self) -> BoardStatus:
        """Return the status of the board."""
        outcome = self._line.ask("STATUS").done()
        unknown = outcome.word(4) == NO_LED
        celsius = None if unknown else round((outcome.number(4) - _ZERO_CELSIUS_DK) / 10, 2)
        status = BoardStatus(
            uptime_ms=outcome.number(0),
            led=outcome.led(1),
            faults=outcome.number(2),
            trips=outcome.number(3),
            temperature_c=celsius,
            state=outcome.word(5),
            done=outcome.number(6),
        )
        self._uptime_ms, self._uptime_asked_s = status.uptime_ms, clock.monotonic()
        return status

    def ping(self) -> None:
        """Send the board a sign of life, which keeps its watchdog from acting.

        Call it at least every 300 ms while an LED is kept on or a sequence runs.

        Raises
        ------
        BoardError
            Also if the board has restarted since the last query, or refused the pending flash.
        """
        # The query is sent after this, so the board's clock has advanced by at least this time.
        passed_ms = (clock.monotonic() - self._uptime_asked_s) * 1000
        before_ms = self._uptime_ms
        now_ms = self.status().uptime_ms
        wrapped = before_ms + passed_ms * (1 + _CLOCKS_DIFFER) >= _UPTIME_WRAPS_MS
        if now_ms + 2 < before_ms + passed_ms * (1 - _CLOCKS_DIFFER) and not wrapped:
            raise BoardError(
                f"LED board on {self.port} restarted {now_ms} ms ago and lost what it was doing: "
                "check its supply and cable, then shoot again"
            )
        flash = self._line.begun()
        if flash is not None and flash.error is not None:
            self._line.abandon()
            flash.done()

    def flash(self, led: int | None, settle_us: int, hold_us: int) -> FlashReport:
        """Flash an LED with one trigger pulse and wait for the end: see `begin_flash`."""
        self.begin_flash(led, settle_us, hold_us)
        return self.end_flash()

    def begin_flash(self, led: int | None, settle_us: int, hold_us: int) -> None:
        """Let the board turn an LED on, pulse the trigger line, and turn the LED off by itself.

        Parameters
        ----------
        led
            The LED, None for a flash in the dark.
        settle_us
            Time from turning the LED on to the pulse, 0 to 1 000 000.
        hold_us
            Time from the pulse to turning the LED off, at least 10.
        """
        lasts_s = (settle_us + hold_us) / 1e6
        self._line.begin(lasts_s, "FLASH", _word(led), str(settle_us), str(hold_us))

    def end_flash(self) -> FlashReport:
        """Wait for the end of the pending flash, and return its report.

        Raises
        ------
        BoardError
            Also if the board may have flashed twice, because it restarted in between.
        """
        outcome = self._line.finish().done().repeats(1)
        if outcome.again:
            self.ping()
        led, lit_us = outcome.led(0), outcome.number(2)
        since_us = None if outcome.word(1) == NO_LED else outcome.number(1)
        active_us, cut_off = outcome.exposure(3)
        return FlashReport(outcome.seq, led, since_us, lit_us, active_us, cut_off)

    def load(self, steps: Sequence[Step]) -> None:
        """Load a sequence of at most ``max_steps`` steps (see `BoardIdentity`)."""
        for index, step in enumerate(steps):
            times = (str(step.settle_us), str(step.hold_us), str(step.gap_us))
            self._echoed("STEP", str(index), _word(step.led), *times)

    def run(self, count: int, pace: Literal["time", "exposure"] = "time") -> BoardEcho:
        """Start the first ``count`` of the loaded steps.

        Parameters
        ----------
        count
            Number of steps.
        pace
            "time": every step lasts as declared. "exposure": the LED of a step turns off when the
            camera's exposure-active output has risen and fallen, and a step without an exposure
            ends the sequence.
        """
        outcome = self._line.ask("RUN", str(count), _PACES[pace]).done().repeats(1)
        return BoardEcho(outcome.seq, None)

    def step_report(self, index: int) -> StepReport | None:
        """Return the report of a step of the running or last sequence; None before it has ended."""
        outcome = self._line.ask("DID", str(index))
        if outcome.error == ErrorCode.NO_SUCH_STEP:
            return None
        outcome.done().repeats(1)
        led, trigger_us, lit_us = outcome.led(1), outcome.number(2), outcome.number(3)
        active_us, cut_off = outcome.exposure(4)
        return StepReport(index, led, trigger_us, lit_us, active_us, cut_off)

    def darken(self) -> None:
        """Send one OFF directly to the port, without waiting and without raising.

        For emergencies: it may be called from a signal handler or another thread, even while
        another command is in progress. A pending command is no longer repeated, except OFF.
        """
        self._line.darken()

    def close(self) -> None:
        """Close the port. The LEDs stay as they are: the board turns them off by itself.

        Raises
        ------
        BoardError
            If closing fails.
        """
        self._line.close()

    def _handshake(self, timeout_s: float) -> BoardIdentity:
        self._line.clear()
        outcome = self._line.ask("ID", attempts=max(1, round(timeout_s / REPLY_TIMEOUT_S))).done()
        # Name and version are the first words in every version of the protocol.
        version = " ".join(outcome.words[1:2])
        if version != str(PROTOCOL_VERSION):
            raise BoardError(
                f"LED board on {self.port} speaks protocol {version or '?'}, but this software "
                f"speaks {PROTOCOL_VERSION}: update the firmware or the software"
            )
        return BoardIdentity(
            name=outcome.word(0),
            protocol=PROTOCOL_VERSION,
            firmware=outcome.word(2),
            leds=outcome.number(3),
            max_hold_ms=outcome.number(4),
            watchdog_ms=outcome.number(5),
            max_steps=outcome.number(6),
        )

    def _echoed(self, verb: str, *args: str) -> Outcome:
        """Send a command whose reply must repeat its arguments."""
        return self._line.ask(verb, *args).done().repeats(len(args))


def _word(led: int | None) -> str:
    return NO_LED if led is None else str(led)
