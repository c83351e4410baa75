"""Outputs of the virtual board, LEDs and trigger line, and its exposure-active input."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from simulator.bench.state import NEVER_NS, BenchState, BenchWriter, ExposurePeriod

TRIGGER_NS = 200_000
Event = dict[str, int | list[int]]
# Number of lights and of pulses that are kept for `BoardOutputs.events`.
_KEPT = 256


@dataclass
class _Span:
    """Period in which the trigger line is high."""

    start_ns: int
    end_ns: int


@dataclass
class Light(_Span):
    """Period in which an LED is on, and the number of this period in the bench state."""

    led: int
    level: int
    period: int


class BoardOutputs:
    """LEDs and trigger line, which are recorded in the bench state.

    Times may be in the future; light and pulses no longer change once they are in the past.

    Parameters
    ----------
    bench
        Writer of the bench state.

    Attributes
    ----------
    double_led
        LED that is on whenever another LED is on; None if the wiring has no fault.
    wire
        Function from the time of a trigger pulse to the times of the pulses that the camera sees.
    """

    def __init__(self, bench: BenchWriter) -> None:
        self._bench = bench
        self.double_led: int | None = None
        self.wire: Callable[[int], tuple[int, ...]] = lambda time_ns: (time_ns,)
        self._lights: deque[Light] = deque(maxlen=_KEPT)
        self._pulses: deque[_Span] = deque(maxlen=_KEPT)
        # The lights and pulses that may have a future edge; `next_event_ns` removes the others.
        self._ahead: deque[_Span] = deque(maxlen=2 * _KEPT)
        self._reported_ns = -1
        self._reported: tuple[dict[int, int], bool] | None = None

    def light(self, led: int, start_ns: int, end_ns: int, level: int) -> tuple[Light, ...]:
        """Turn an LED on for a period; return its lights, the argument of `end`."""
        leds = {led} if self.double_led is None else {led, self.double_led}
        lights = tuple(
            Light(start_ns, end_ns, lit, level, self._bench.light(lit, start_ns, end_ns, level))
            for lit in leds
        )
        self._lights.extend(lights)
        self._ahead.extend(lights)
        return lights

    def end(self, lights: tuple[Light, ...], end_ns: int) -> None:
        """Move the end of lights that `light` returned, and lower the trigger line at that time."""
        for light in lights:
            self._bench.end(light.period, end_ns)
            light.end_ns = end_ns
        for pulse in self._pulses:
            if pulse.start_ns <= end_ns:
                pulse.end_ns = min(pulse.end_ns, end_ns)

    def pulse(self, time_ns: int, hold_ns: int) -> None:
        """Raise the trigger line; lower it after 200 us, or after ``hold_ns`` if that is less."""
        for seen_ns in self.wire(time_ns):
            self._bench.pulse(seen_ns)
        pulse = _Span(time_ns, time_ns + min(TRIGGER_NS, hold_ns))
        self._pulses.append(pulse)
        self._ahead.append(pulse)

    def pulse_before_ns(self, time_ns: int) -> int | None:
        """Return the time of the last rising edge before a time; None if there is no edge."""
        rises = (pulse.start_ns for pulse in self._pulses if pulse.end_ns > pulse.start_ns)
        return max((rise for rise in rises if rise < time_ns), default=None)

    def put_out(self, now_ns: int) -> None:
        """Turn all LEDs off, lower the trigger line, and cancel all future light and pulses."""
        self._bench.put_out(now_ns)
        for span in (*self._lights, *self._pulses):
            span.end_ns = min(span.end_ns, max(now_ns, span.start_ns))

    def events(self, now_ns: int) -> list[Event]:
        """Return the edges since the last call, with their times in us."""
        edges_ns = _edges_ns((*self._lights, *self._pulses))
        times = {time_ns for time_ns in edges_ns if self._reported_ns <= time_ns < now_ns}
        events: list[Event] = []
        for time_ns in sorted(times | {now_ns}):
            lights = [one for one in self._lights if one.start_ns <= time_ns < one.end_ns]
            lit = {light.led: light.level for light in lights if light.level}
            state = lit, any(one.start_ns <= time_ns < one.end_ns for one in self._pulses)
            before = self._reported or (None, False)
            if state[0] != before[0]:
                leds = sorted(lit)
                levels = [lit[led] for led in leds]
                events.append({"us": time_ns // 1000, "lit": leds, "levels": levels})
            if state[1] != before[1]:
                events.append({"us": time_ns // 1000, "trigger": int(state[1])})
            self._reported = state
        self._reported_ns = now_ns
        return events

    def next_event_ns(self, now_ns: int) -> int:
        """Return the time of the next edge."""
        ahead = (span for span in self._ahead if span.end_ns > now_ns)
        self._ahead = deque(ahead, self._ahead.maxlen)
        edges_ns = _edges_ns(self._ahead)
        return min((time_ns for time_ns in edges_ns if time_ns > now_ns), default=NEVER_NS)


def _edges_ns(spans: Iterable[_Span]) -> Iterator[int]:
    for span in spans:
        yield span.start_ns
        yield span.end_ns


class ActiveInput:
    """The input to which the camera's exposure-active output is wired.

    Parameters
    ----------
    bench
        Bench state to which a simulated camera writes its exposures; None for an input that only
        `set` changes.
    """

    def __init__(self, bench: BenchState | None = None) -> None:
        self._bench = bench
        self._wired: list[ExposurePeriod] = []

    def set(self, up: bool, now_ns: int) -> None:
        """Set the level of the input; setting its present level makes no edge."""
        was_up = bool(self._wired) and self._wired[-1].end_ns == NEVER_NS
        if was_up and not up:
            self._wired[-1] = ExposurePeriod(self._wired[-1].start_ns, now_ns)
        if up and not was_up:
            self._wired = [*self._wired[-_KEPT:], ExposurePeriod(now_ns, NEVER_NS)]

    def stated(self) -> bool:
        """Return whether a simulated camera writes exposures, perhaps with a delay."""
        return self._bench is not None and bool(self._bench.exposures())

    def exposures(self) -> tuple[ExposurePeriod, ...]:
        """Return the periods in which the input was high or is known to be high."""
        stated = () if self._bench is None else self._bench.exposures()
        return (*self._wired, *stated)
