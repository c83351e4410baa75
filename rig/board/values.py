"""Values that the LED board receives and reports."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BoardIdentity:
    """Identity of the board that answered on a port.

    Parameters
    ----------
    name
        Name of the firmware.
    protocol
        Version of the serial protocol.
    firmware
        Version of the firmware.
    leds
        Number of LEDs that the board drives; they are numbered from 0.
    max_hold_ms
        Longest time for which the board keeps an LED on.
    watchdog_ms
        Silence of the host after which an LED turned on by ON is turned off.
    max_steps
        Maximum number of steps of a sequence.
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
    """The board's confirmation of a command.

    Parameters
    ----------
    seq
        Sequence number of the command.
    led
        The LED acted on. For OFF: the LED that was on until now, None if all were off.
    lit_us, active_us
        For a flash or a step: how long the LED was on, and how long the camera's exposure-active
        output was high meanwhile; None if not measured.
    """

    seq: int
    led: int | None
    lit_us: int | None = None
    active_us: int | None = None


@dataclass(frozen=True)
class BoardStatus:
    """Status of the board.

    Parameters
    ----------
    uptime_ms
        Time since the board started, modulo 10^9; a small value indicates a reset.
    led
        The LED that is on, None if all are off.
    faults
        Number of damaged lines received since the board started.
    trips
        Number of times the watchdog acted since the board started.
    temperature_c
        The board's temperature in degrees Celsius, None if it does not report one.
    state
        IDLE, ON, FLASH, RUN, or HALT for a sequence that ended before its last step by itself.
    done
        Number of steps of the running or last sequence that have ended.
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
    """The board's report of a flash.

    Parameters
    ----------
    seq
        Sequence number of the command.
    led
        The LED, None for a flash in the dark.
    since_us
        Time from the previous trigger pulse to this one, by the board's clock; None for the first
        pulse since the board started, or the first one for a quarter of an hour.
    lit_us
        How long the LED was on, by the board's clock.
    active_us
        How long the camera's exposure-active output was high meanwhile; None if it never was, or
        is not wired.
    cut_off
        Whether the exposure-active output was still high when the light turned off.
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
        Time from turning the LED on to the trigger pulse, 0 to 1 000 000.
    hold_us
        Time from the trigger pulse to turning the LED off, at least 10.
    gap_us
        Darkness before the next step, 0 to 1 000 000.
    """

    led: int | None
    settle_us: int
    hold_us: int
    gap_us: int


@dataclass(frozen=True)
class StepReport:
    """The board's report of a step of the running or last sequence.

    Parameters
    ----------
    index
        Index of the step, from 0.
    trigger_us
        Time from the start of the sequence to the step's trigger pulse, by the board's clock.
    led, lit_us, active_us, cut_off
        See `FlashReport`.
    """

    index: int
    led: int | None
    trigger_us: int
    lit_us: int
    active_us: int | None
    cut_off: bool
