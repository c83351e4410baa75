"""What is told to the LED board and what it tells, as values."""

from __future__ import annotations

from dataclasses import dataclass


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
    watchdog_ms
        Silence of the host after which an LED lit by ON goes out.
    max_steps
        How many steps a sequence may have.
    """

    name: str
    protocol: int
    firmware: str
    leds: int
    max_hold_ms: int
    watchdog_ms: int
    max_steps: int


@dataclass(frozen=True)
class BoardEcho:
    """What the board said it did.

    Parameters
    ----------
    seq
        Sequence number of the command.
    led
        The LED acted on. Of an OFF: the LED that burned until now, None where all were dark.
    lit_us, active_us
        Of a flash or a step: for how long the LED burned, and for how long the camera's
        exposure-active output was up meanwhile; None where not measured.
    """

    seq: int
    led: int | None
    lit_us: int | None = None
    active_us: int | None = None


@dataclass(frozen=True)
class BoardStatus:
    """How the board is.

    Parameters
    ----------
    uptime_ms
        Time since the board started, modulo 10^9; a small value betrays a reset.
    led
        The LED that burns, None where all are dark.
    faults
        Damaged lines received since the board started.
    trips
        How often the watchdog acted since the board started.
    temperature_c
        The board's temperature in degrees Celsius, None where it does not tell.
    state
        IDLE, ON, FLASH, RUN, or HALT for a sequence that ended before its last step by itself.
    done
        How many steps of the running or last sequence have ended.
    """

    uptime_ms: int
    led: int | None
    faults: int
    trips: int
    temperature_c: float | None
    state: str
    done: int


@dataclass(frozen=True)
class FlashReport:
    """What a flash did.

    Parameters
    ----------
    seq
        Sequence number of the command.
    led
        The LED, None for a flash in the dark.
    since_us
        How long the trigger pulse came after the one before it, by the board's clock; None where
        there was none since the board started, or not for a quarter of an hour.
    lit_us
        How long it burned, by the board's clock.
    active_us
        How long the camera's exposure-active output was up meanwhile; None where it never was, or
        is not wired.
    cut_off
        The exposure-active output was still up when the light went out.
    """

    seq: int
    led: int | None
    since_us: int | None
    lit_us: int
    active_us: int | None
    cut_off: bool


@dataclass(frozen=True)
class Step:
    """One step of a sequence: a flash and the darkness after it.

    Parameters
    ----------
    led
        The LED, None for a step in the dark.
    settle_us
        From the light to the trigger pulse, 0 to 1 000 000.
    hold_us
        From the trigger pulse to the end of the light, at least 10.
    gap_us
        Darkness before the next step, 0 to 1 000 000.
    """

    led: int | None
    settle_us: int
    hold_us: int
    gap_us: int


@dataclass(frozen=True)
class StepReport:
    """What a step of the running or last sequence did.

    Parameters
    ----------
    index
        Which step, from 0.
    trigger_us
        When its trigger pulse began, since the start of the sequence, by the board's clock.
    led, lit_us, active_us, cut_off
        See `FlashReport`.
    """

    index: int
    led: int | None
    trigger_us: int
    lit_us: int
    active_us: int | None
    cut_off: bool
