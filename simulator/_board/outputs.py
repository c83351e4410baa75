"""What the virtual board drives, LEDs and trigger line, and what it reads, exposure-active."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from simulator._bench_state import FULL_LEVEL, NEVER_NS, BenchState, BenchWriter, Exposure

TRIGGER_NS = 200_000
Event = dict[str, int | list[int]]
# Spans of light and trigger that are kept for `BoardOutputs.events`.
_KEPT = 256


@dataclass
class _Span:
    """An LED burning, or (None) the trigger line being high."""

    led: int | None
    start_ns: int
    end_ns: int
    level: int = FULL_LEVEL


class BoardOutputs:
    """LEDs and trigger line, stated in the bench state.

    What is asked may lie ahead and is not changed any more once it has passed.

    Parameters
    ----------
    bench
        Where light and pulses are stated.

    Attributes
    ----------
    double_led
        An LED that burns along with every one that is lit; None for sound wiring.
    wire
        What becomes of a trigger pulse: its time to the times at which the camera sees one.
    """

    def __init__(self, bench: BenchWriter) -> None:
        self._bench = bench
        self.double_led: int | None = None
        self.wire: Callable[[int], tuple[int, ...]] = lambda time_ns: (time_ns,)
        self._spans: deque[_Span] = deque(maxlen=_KEPT)
        self._told_ns = -1
        self._told: tuple[dict[int, int], bool] | None = None

    def light(self, led: int, start_ns: int, end_ns: int, level: int) -> tuple[int, ...]:
        """Let an LED burn; return what `end` takes."""
        leds = {led} if self.double_led is None else {led, self.double_led}
        for lit in leds:
            self._spans.append(_Span(lit, start_ns, end_ns, level))
        return tuple(self._bench.light(lit, start_ns, end_ns, level) for lit in leds)

    def end(self, light: tuple[int, ...], start_ns: int, end_ns: int) -> None:
        """Move the end of a light that began at ``start_ns``, and lower the trigger line then."""
        for period in light:
            self._bench.end(period, end_ns)
        for span in self._spans:
            if span.led is not None and span.start_ns == start_ns:
                span.end_ns = end_ns
            elif span.led is None and span.start_ns <= end_ns:
                span.end_ns = min(span.end_ns, end_ns)

    def pulse(self, time_ns: int, hold_ns: int) -> None:
        """Raise the trigger line, and lower it after 200 us or ``hold_ns`` if that is sooner."""
        for seen_ns in self.wire(time_ns):
            self._bench.pulse(seen_ns)
        self._spans.append(_Span(None, time_ns, time_ns + min(TRIGGER_NS, hold_ns)))

    def pulse_before_ns(self, time_ns: int) -> int | None:
        """Return when the trigger line rose last before a time; None if it never did."""
        rises = (s.start_ns for s in self._spans if s.led is None and s.end_ns > s.start_ns)
        return max((rise for rise in rises if rise < time_ns), default=None)

    def put_out(self, now_ns: int) -> None:
        """End all light and lower the trigger line, and take back what was to come."""
        self._bench.put_out(now_ns)
        for span in self._spans:
            span.end_ns = min(span.end_ns, max(now_ns, span.start_ns))

    def events(self, now_ns: int) -> list[Event]:
        """Return the edges since the last call, with their times in us."""
        times = {t for span in self._spans for t in (span.start_ns, span.end_ns)}
        events: list[Event] = []
        for time_ns in sorted({t for t in times if self._told_ns <= t < now_ns} | {now_ns}):
            on = [span for span in self._spans if span.start_ns <= time_ns < span.end_ns]
            lit = {span.led: span.level for span in on if span.led is not None and span.level}
            state = lit, any(span.led is None for span in on)
            before = self._told or (None, False)
            if state[0] != before[0]:
                leds = sorted(lit)
                levels = [lit[led] for led in leds]
                events.append({"us": time_ns // 1000, "lit": leds, "levels": levels})
            if state[1] != before[1]:
                events.append({"us": time_ns // 1000, "trigger": int(state[1])})
            self._told = state
        self._told_ns = now_ns
        return events

    def next_event_ns(self, now_ns: int) -> int:
        """Return when the next edge is due."""
        times = (t for span in self._spans for t in (span.start_ns, span.end_ns) if t > now_ns)
        return min(times, default=NEVER_NS)


class ActiveInput:
    """The input to which the camera's exposure-active output is wired.

    Parameters
    ----------
    bench
        Where a simulated camera states its exposures; None for a wire that `set` alone drives.
    """

    def __init__(self, bench: BenchState | None = None) -> None:
        self._bench = bench
        self._wired: list[Exposure] = []

    def set(self, up: bool, now_ns: int) -> None:
        """Raise or lower the input by hand."""
        if self._wired and self._wired[-1].end_ns == NEVER_NS:
            self._wired[-1] = Exposure(self._wired[-1].start_ns, now_ns)
        if up:
            self._wired = [*self._wired[-_KEPT:], Exposure(now_ns, NEVER_NS)]

    def stated(self) -> bool:
        """Return whether a simulated camera states exposures, which may take it a while."""
        return self._bench is not None and bool(self._bench.exposures())

    def exposures(self) -> tuple[Exposure, ...]:
        """Return when the input was up, or is known to be up."""
        stated = () if self._bench is None else self._bench.exposures()
        return (*self._wired, *stated)
