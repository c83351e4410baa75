"""Timing of the virtual board's LEDs and trigger line: flashes, sequences and the watchdog.

Time is an argument; no method sleeps or reads a clock.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Literal

from rig.board import Step
from simulator.bench.state import FULL_LEVEL, NEVER_NS, ExposurePeriod
from simulator.led_board.outputs import ActiveInput, BoardOutputs, Light

WATCHDOG_NS = 900_000_000
_SINCE_MOST_US = 999_000_000
State = Literal["IDLE", "ON", "FLASH", "RUN", "HALT"]
_US = 1000
# Steps are recorded this long in advance, so that a process that is delayed does not delay them.
_AHEAD_NS = 250_000_000
# Longest delay with which a simulated camera, which has no wire, records an exposure, and the
# interval of checks for it. Host and camera may wait for a busy computer; the host repeats the
# request for a flash after 250 ms.
_GRACE_NS = 200_000_000
_LOOK_NS = 1_000_000


@dataclass
class Flash:
    """One flash of an LED, or a flash without light (``led`` None)."""

    led: int | None
    start_ns: int
    trigger_ns: int
    end_ns: int
    lights: tuple[Light, ...] = ()


@dataclass(frozen=True)
class FlashRecord:
    """Times of a flash that has ended, in us; ``active_us``: None if no exposure was seen."""

    led: int | None
    trigger_us: int
    since_us: int | None
    lit_us: int
    active_us: int | None
    cut_off: bool


class BoardLight:
    """The state machine behind ON, OFF, FLASH and RUN.

    Parameters
    ----------
    leds
        Number of LEDs.
    outputs, active
        Outputs and exposure-active input.
    now_ns
        Time of power-on.

    Attributes
    ----------
    state
        State as in the reply to STATUS.
    trips
        Number of times that the watchdog acted.
    levels
        Brightness of each LED, in effect from the next time it turns on.
    steps
        Loaded steps by index.
    done
        Records of the steps of the running or last sequence that have ended.
    """

    def __init__(self, leds: int, outputs: BoardOutputs, active: ActiveInput, now_ns: int) -> None:
        self._outputs = outputs
        self._active = active
        outputs.put_out(now_ns)
        self._boot_ns = now_ns
        self.state: State = "IDLE"
        self.trips = 0
        self.levels = [FULL_LEVEL] * leds
        self.steps: dict[int, Step] = {}
        self.done: list[FlashRecord] = []
        self._heard_ns = now_ns
        # Flashes that are recorded and have not ended, in order; at most one except in a sequence.
        self._flashes: deque[Flash] = deque()
        self._hold_ends_ns = 0
        self._count = 0
        self._by_exposure = False
        self._run_ns = 0
        self._planned = 0
        self._due_ns = 0
        self._stopping = False

    @property
    def busy(self) -> bool:
        """Whether a flash or a sequence is running."""
        return self.state in ("FLASH", "RUN")

    def led(self, now_ns: int) -> int | None:
        """Return the LED that is on; None if all are off."""
        for flash in self._flashes:
            if flash.start_ns <= now_ns < flash.end_ns:
                return flash.led
        return None

    def heard(self, now_ns: int) -> None:
        """Restart the watchdog: the host has sent a command."""
        self._heard_ns = now_ns
        if self.state == "ON":
            self._end(self._flashes[0], min(self._hold_ends_ns, now_ns + WATCHDOG_NS))

    def on(self, led: int, hold_ns: int, now_ns: int) -> None:
        """Turn this LED on and all others off."""
        self.off(now_ns)
        self.state = "ON"
        self._hold_ends_ns = now_ns + hold_ns
        end_ns = min(self._hold_ends_ns, self._heard_ns + WATCHDOG_NS)
        self._light(led, now_ns, NEVER_NS, end_ns)

    def off(self, now_ns: int) -> int | None:
        """Turn everything off and return the LED that was on until now."""
        led = self.led(now_ns)
        self._outputs.put_out(now_ns)
        self._flashes.clear()
        self.state = "IDLE"
        return led

    def flash(self, led: int | None, settle_us: int, hold_us: int, now_ns: int) -> None:
        """Begin a flash; `advance` returns its record when it has ended."""
        self.off(now_ns)
        self.state = "FLASH"
        self._by_exposure = False
        self._flash(led, settle_us, hold_us, now_ns)

    def run(self, count: int, by_exposure: bool, now_ns: int) -> None:
        """Begin a sequence of the first ``count`` loaded steps."""
        self.off(now_ns)
        self.state = "RUN"
        self.done = []
        self._count = count
        self._by_exposure = by_exposure
        self._run_ns = self._due_ns = now_ns
        self._planned = 0
        self._stopping = False
        self.advance(now_ns)

    def end_halt(self) -> None:
        """Change the state HALT to IDLE."""
        if self.state == "HALT":
            self.state = "IDLE"

    def fail(self, at_ns: int) -> None:
        """Turn the LED that is on off at a time, even before its declared end."""
        if self._flashes:
            self._hold_ends_ns = min(self._hold_ends_ns, at_ns)
            self._end(self._flashes[0], min(self._flashes[0].end_ns, at_ns))

    def advance(self, now_ns: int) -> FlashRecord | None:
        """Carry out all actions that are due; return the record of a flash that has just ended."""
        if self.state == "ON" and now_ns >= self._flashes[0].end_ns:
            self.trips += self._flashes[0].end_ns < self._hold_ends_ns
            self._flashes.clear()
            self.state = "IDLE"
        elif self.state == "FLASH" and self._ended(self._flashes[0], now_ns):
            self.state = "IDLE"
            return self._did(self._flashes.popleft())
        while self.state == "RUN" and (self._end_step(now_ns) or self._plan_step(now_ns)):
            pass
        if self.state == "RUN":
            self._watch(now_ns)
        return None

    def next_ns(self, now_ns: int) -> int:
        """Return the time at which `advance` is due again, as far as is known now."""
        due = [NEVER_NS]
        if self._flashes:
            first = self._flashes[0]
            waiting = now_ns >= first.end_ns or (self._by_exposure and self._active.stated())
            due.append(now_ns + _LOOK_NS if self.busy and waiting else first.end_ns)
        if self.state == "RUN" and self._planned < self._count and not self._stopping:
            silent_ns = self._heard_ns + WATCHDOG_NS
            due.append(silent_ns)
            if self._due_ns < silent_ns and not (self._by_exposure and self._flashes):
                due.append(self._due_ns - _AHEAD_NS)
        return min(due)

    def _light(self, led: int | None, start_ns: int, trigger_ns: int, end_ns: int) -> None:
        flash = Flash(led, start_ns, trigger_ns, end_ns)
        if led is not None:
            flash.lights = self._outputs.light(led, start_ns, end_ns, self.levels[led])
        self._flashes.append(flash)

    def _flash(self, led: int | None, settle_us: int, hold_us: int, start_ns: int) -> None:
        trigger_ns = start_ns + settle_us * _US
        self._light(led, start_ns, trigger_ns, trigger_ns + hold_us * _US)
        self._outputs.pulse(trigger_ns, hold_us * _US)

    def _end(self, flash: Flash, end_ns: int) -> None:
        flash.end_ns = end_ns
        self._outputs.end(flash.lights, end_ns)

    def _exposures(self, flash: Flash) -> list[ExposurePeriod]:
        """Return the exposures of the camera while the LED was on."""
        exposures = self._active.exposures()
        return [e for e in exposures if e.start_ns < flash.end_ns and e.end_ns > flash.start_ns]

    def _ended(self, flash: Flash, now_ns: int) -> bool:
        """Return whether a flash has ended and its exposures are known."""
        if now_ns < flash.end_ns:
            return False
        late = self._active.stated() and now_ns < flash.end_ns + _GRACE_NS
        return not late or bool(self._exposures(flash))

    def _did(self, flash: Flash) -> FlashRecord:
        seen = self._exposures(flash)
        spans = [(max(e.start_ns, flash.start_ns), min(e.end_ns, flash.end_ns)) for e in seen]
        return FlashRecord(
            flash.led,
            (flash.trigger_ns - self._run_ns) // _US,
            self._since_us(flash.trigger_ns),
            (flash.end_ns - flash.start_ns) // _US,
            sum(end - start for start, end in spans) // _US if seen else None,
            any(e.end_ns > flash.end_ns for e in seen),
        )

    def _since_us(self, trigger_ns: int) -> int | None:
        """Return the time between a pulse and the one before it; None if unknown or too long."""
        before_ns = self._outputs.pulse_before_ns(trigger_ns)
        if before_ns is None or before_ns < self._boot_ns:
            return None
        since_us = (trigger_ns - before_ns) // _US
        return since_us if since_us < _SINCE_MOST_US else None

    def _fell_ns(self, flash: Flash) -> int:
        """Return the end of the exposure that began after the trigger, as far as is known."""
        falls = [e.end_ns for e in self._exposures(flash) if e.start_ns >= flash.trigger_ns]
        return min(falls, default=NEVER_NS)

    def _end_step(self, now_ns: int) -> bool:
        """End the step that is over; return whether there was one."""
        if not self._flashes:
            return False
        flash = self._flashes[0]
        if self._by_exposure and self._fell_ns(flash) < flash.end_ns and now_ns < flash.end_ns:
            self._end(flash, max(self._fell_ns(flash), now_ns))
        if not self._ended(flash, now_ns):
            return False
        self._flashes.popleft()
        self.done.append(self._did(flash))
        if self._by_exposure:
            self._due_ns = flash.end_ns + self.steps[len(self.done) - 1].gap_us * _US
            if self._fell_ns(flash) > flash.end_ns:
                self.state = "HALT"
                return True
        if len(self.done) == self._count:
            self.state = "IDLE"
        elif self._stopping and not self._flashes:
            self.state = "HALT"
        return True

    def _plan_step(self, now_ns: int) -> bool:
        """Record the next step if it is certain and due soon; return whether it was recorded."""
        if self._planned == self._count or self._stopping:
            return False
        if self._by_exposure and self._flashes:
            return False
        start_ns = max(self._due_ns, now_ns)
        if start_ns > now_ns + _AHEAD_NS or start_ns >= self._heard_ns + WATCHDOG_NS:
            return False
        step = self.steps[self._planned]
        self._flash(step.led, step.settle_us, step.hold_us, start_ns)
        self._planned += 1
        self._due_ns = self._flashes[-1].end_ns + step.gap_us * _US
        return True

    def _watch(self, now_ns: int) -> None:
        """Stop a sequence if the host has been silent for too long."""
        silent = now_ns >= self._heard_ns + WATCHDOG_NS
        if not silent or self._stopping or self._planned == self._count:
            return
        self.trips += 1
        self._stopping = True
        if not self._flashes:
            self.state = "HALT"
