"""The virtual board's light and trigger in time: what burns, until when, and who ends it.

Time comes as an argument; nothing here sleeps or looks at a clock.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Literal

from rig import Step
from simulator._bench_state import FULL_LEVEL, NEVER_NS, Exposure
from simulator._board.outputs import ActiveInput, BoardOutputs, Light

WATCHDOG_NS = 900_000_000
_SINCE_MOST_US = 999_000_000
State = Literal["IDLE", "ON", "FLASH", "RUN", "HALT"]
_US = 1000
# Steps are stated this long ahead, so that a process that sleeps too long delays none.
_AHEAD_NS = 250_000_000
# How late a simulated camera may state an exposure, for want of a wire, and how often to look. The
# host and its camera may have to wait for a busy computer; a flash is asked for again after 250 ms.
_GRACE_NS = 200_000_000
_LOOK_NS = 1_000_000


@dataclass
class Burn:
    """One light from on to off, of an LED or (None) of none."""

    led: int | None
    start_ns: int
    trigger_ns: int
    end_ns: int
    lights: tuple[Light, ...] = ()


@dataclass(frozen=True)
class Burned:
    """What a light did, in us; ``active_us`` is None where no exposure was seen."""

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
        How many LEDs there are.
    outputs, active
        What is driven and read.
    now_ns
        Time of power-on.

    Attributes
    ----------
    state
        As STATUS tells it.
    trips
        How often the watchdog acted.
    levels
        Brightness of each LED from its next lighting on.
    steps
        The loaded steps by index.
    done
        What the steps of the running or last sequence did that have ended.
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
        self.done: list[Burned] = []
        self._heard_ns = now_ns
        # Lights stated and not yet ended, in order; one at most, except in a sequence.
        self._burns: deque[Burn] = deque()
        self._hold_ends_ns = 0
        self._count = 0
        self._by_exposure = False
        self._run_ns = 0
        self._planned = 0
        self._due_ns = 0
        self._stopping = False

    @property
    def busy(self) -> bool:
        """A flash or a sequence is running."""
        return self.state in ("FLASH", "RUN")

    def led(self, now_ns: int) -> int | None:
        """Return the LED that burns."""
        for burn in self._burns:
            if burn.start_ns <= now_ns < burn.end_ns:
                return burn.led
        return None

    def heard(self, now_ns: int) -> None:
        """Take a sign of life from the host."""
        self._heard_ns = now_ns
        if self.state == "ON":
            self._end(self._burns[0], min(self._hold_ends_ns, now_ns + WATCHDOG_NS))

    def on(self, led: int, hold_ns: int, now_ns: int) -> None:
        """Light exactly this LED."""
        self.off(now_ns)
        self.state = "ON"
        self._hold_ends_ns = now_ns + hold_ns
        end_ns = min(self._hold_ends_ns, self._heard_ns + WATCHDOG_NS)
        self._light(led, now_ns, NEVER_NS, end_ns)

    def off(self, now_ns: int) -> int | None:
        """End everything and return the LED that burned until now."""
        led = self.led(now_ns)
        self._outputs.put_out(now_ns)
        self._burns.clear()
        self.state = "IDLE"
        return led

    def flash(self, led: int | None, settle_us: int, hold_us: int, now_ns: int) -> None:
        """Begin a flash; `advance` returns what it did."""
        self.off(now_ns)
        self.state = "FLASH"
        self._by_exposure = False
        self._flash(led, settle_us, hold_us, now_ns)

    def run(self, count: int, by_exposure: bool, now_ns: int) -> None:
        """Begin the first ``count`` loaded steps."""
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
        """Let HALT be IDLE."""
        if self.state == "HALT":
            self.state = "IDLE"

    def fail(self, at_ns: int) -> None:
        """Let the light that burns go out at a time, whatever was declared."""
        if self._burns:
            self._hold_ends_ns = min(self._hold_ends_ns, at_ns)
            self._end(self._burns[0], min(self._burns[0].end_ns, at_ns))

    def advance(self, now_ns: int) -> Burned | None:
        """Do what is due by now; return what a flash did when it has just ended."""
        if self.state == "ON" and now_ns >= self._burns[0].end_ns:
            self.trips += self._burns[0].end_ns < self._hold_ends_ns
            self._burns.clear()
            self.state = "IDLE"
        elif self.state == "FLASH" and self._ended(self._burns[0], now_ns):
            self.state = "IDLE"
            return self._did(self._burns.popleft())
        while self.state == "RUN" and (self._end_step(now_ns) or self._plan_step(now_ns)):
            pass
        if self.state == "RUN":
            self._watch(now_ns)
        return None

    def next_ns(self, now_ns: int) -> int:
        """Return when `advance` is due again, as far as is known now."""
        due = [NEVER_NS]
        if self._burns:
            first = self._burns[0]
            waiting = now_ns >= first.end_ns or (self._by_exposure and self._active.stated())
            due.append(now_ns + _LOOK_NS if self.busy and waiting else first.end_ns)
        if self.state == "RUN" and self._planned < self._count and not self._stopping:
            silent_ns = self._heard_ns + WATCHDOG_NS
            due.append(silent_ns)
            if self._due_ns < silent_ns and not (self._by_exposure and self._burns):
                due.append(self._due_ns - _AHEAD_NS)
        return min(due)

    def _light(self, led: int | None, start_ns: int, trigger_ns: int, end_ns: int) -> None:
        burn = Burn(led, start_ns, trigger_ns, end_ns)
        if led is not None:
            burn.lights = self._outputs.light(led, start_ns, end_ns, self.levels[led])
        self._burns.append(burn)

    def _flash(self, led: int | None, settle_us: int, hold_us: int, start_ns: int) -> None:
        trigger_ns = start_ns + settle_us * _US
        self._light(led, start_ns, trigger_ns, trigger_ns + hold_us * _US)
        self._outputs.pulse(trigger_ns, hold_us * _US)

    def _end(self, burn: Burn, end_ns: int) -> None:
        burn.end_ns = end_ns
        self._outputs.end(burn.lights, end_ns)

    def _exposures(self, burn: Burn) -> list[Exposure]:
        """Return when the camera exposed while the LED burned."""
        exposures = self._active.exposures()
        return [e for e in exposures if e.start_ns < burn.end_ns and e.end_ns > burn.start_ns]

    def _ended(self, burn: Burn, now_ns: int) -> bool:
        """Return whether a light has ended and all is known about it."""
        if now_ns < burn.end_ns:
            return False
        late = self._active.stated() and now_ns < burn.end_ns + _GRACE_NS
        return not late or bool(self._exposures(burn))

    def _did(self, burn: Burn) -> Burned:
        seen = self._exposures(burn)
        spans = [(max(e.start_ns, burn.start_ns), min(e.end_ns, burn.end_ns)) for e in seen]
        return Burned(
            burn.led,
            (burn.trigger_ns - self._run_ns) // _US,
            self._since_us(burn.trigger_ns),
            (burn.end_ns - burn.start_ns) // _US,
            sum(end - start for start, end in spans) // _US if seen else None,
            any(e.end_ns > burn.end_ns for e in seen),
        )

    def _since_us(self, trigger_ns: int) -> int | None:
        """Return how long before it the pulse before a pulse was, if it is known and near."""
        before_ns = self._outputs.pulse_before_ns(trigger_ns)
        if before_ns is None or before_ns < self._boot_ns:
            return None
        since_us = (trigger_ns - before_ns) // _US
        return since_us if since_us < _SINCE_MOST_US else None

    def _fell_ns(self, burn: Burn) -> int:
        """Return when the exposure that rose after the trigger ends, as far as is known."""
        falls = [e.end_ns for e in self._exposures(burn) if e.start_ns >= burn.trigger_ns]
        return min(falls, default=NEVER_NS)

    def _end_step(self, now_ns: int) -> bool:
        """End the step whose time has come; return whether there was one."""
        if not self._burns:
            return False
        burn = self._burns[0]
        if self._by_exposure and self._fell_ns(burn) < burn.end_ns and now_ns < burn.end_ns:
            self._end(burn, max(self._fell_ns(burn), now_ns))
        if not self._ended(burn, now_ns):
            return False
        self._burns.popleft()
        self.done.append(self._did(burn))
        if self._by_exposure:
            self._due_ns = burn.end_ns + self.steps[len(self.done) - 1].gap_us * _US
            if self._fell_ns(burn) > burn.end_ns:
                self.state = "HALT"
                return True
        if len(self.done) == self._count:
            self.state = "IDLE"
        elif self._stopping and not self._burns:
            self.state = "HALT"
        return True

    def _plan_step(self, now_ns: int) -> bool:
        """State the next step if it is certain and near; return whether it was."""
        if self._planned == self._count or self._stopping:
            return False
        if self._by_exposure and self._burns:
            return False
        start_ns = max(self._due_ns, now_ns)
        if start_ns > now_ns + _AHEAD_NS or start_ns >= self._heard_ns + WATCHDOG_NS:
            return False
        step = self.steps[self._planned]
        self._flash(step.led, step.settle_us, step.hold_us, start_ns)
        self._planned += 1
        self._due_ns = self._burns[-1].end_ns + step.gap_us * _US
        return True

    def _watch(self, now_ns: int) -> None:
        """Let the watchdog act on a sequence."""
        silent = now_ns >= self._heard_ns + WATCHDOG_NS
        if not silent or self._stopping or self._planned == self._count:
            return
        self.trips += 1
        self._stopping = True
        if not self._burns:
            self.state = "HALT"
