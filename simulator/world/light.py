"""Light, trigger pulses and exposures of a world, in memory."""

from __future__ import annotations

from collections.abc import Callable

from simulator.bench.state import (
    FULL_LEVEL,
    NEVER_NS,
    RING,
    BenchState,
    BenchWriter,
    ExposurePeriod,
    LitPeriod,
    TriggerPulse,
)


class LightHistory(BenchWriter):
    """The board's part; it remembers every period of light."""

    def __init__(self) -> None:
        self.lit: list[LitPeriod] = []
        self.pulses: list[TriggerPulse] = []
        self.noise: list[TriggerPulse] = []
        self.changes = 0

    def light(self, led: int, start_ns: int, end_ns: int, level: int = FULL_LEVEL) -> int:
        """Record a period; see `BenchWriter`."""
        self.changes += 1
        self.lit.append(LitPeriod(led, start_ns, end_ns, level))
        return len(self.lit) - 1

    def end(self, period: int, end_ns: int) -> None:
        """Move the end of a period; see `BenchWriter`."""
        self.changes += 1
        old = self.lit[period]
        self.lit[period] = LitPeriod(old.led, old.start_ns, max(old.start_ns, end_ns), old.level)

    def pulse(self, time_ns: int) -> int:
        """Record a trigger pulse; see `BenchWriter`."""
        self.changes += 1
        self.pulses.append(TriggerPulse(len(self.pulses), time_ns))
        return len(self.pulses) - 1

    def disturb(self, time_ns: int) -> None:
        """Let a pulse on the trigger line be seen that the board does not send."""
        self.changes += 1
        self.noise.append(TriggerPulse(len(self.noise), time_ns))

    def put_out(self, now_ns: int) -> None:
        """Turn all LEDs off; see `BenchWriter`."""
        for number, old in enumerate(self.lit):
            if old.end_ns > now_ns:
                self.end(number, now_ns)
        for number, pulse in enumerate(self.pulses):
            if now_ns < pulse.time_ns < NEVER_NS:
                self.pulses[number] = TriggerPulse(number, NEVER_NS)
                self.changes += 1

    def close(self) -> None:
        """Close nothing."""


class LightView(BenchState):
    """The camera's part.

    Parameters
    ----------
    history
        The board's part.
    advance
        Lets the board do what is due; called before its part is read.
    """

    def __init__(self, history: LightHistory, advance: Callable[[], None]) -> None:
        self._history = history
        self._advance = advance
        self._exposures: list[ExposurePeriod] = []

    @property
    def changes(self) -> int:
        """Number of changes by the board; see `BenchState`."""
        return self._history.changes

    def periods(self) -> tuple[LitPeriod, ...]:
        """Return the last lit periods; see `BenchState`."""
        self._advance()
        return tuple(self._history.lit[-RING:])

    def triggers(self) -> tuple[TriggerPulse, ...]:
        """Return the last trigger pulses; see `BenchState`."""
        self._advance()
        last = (*self._history.pulses[-RING:], *self._history.noise[-RING:])
        seen = (pulse for pulse in last if pulse.time_ns != NEVER_NS)
        return tuple(sorted(seen, key=lambda pulse: pulse.time_ns))

    def exposures(self) -> tuple[ExposurePeriod, ...]:
        """Return the last exposures; see `BenchState`."""
        return tuple(self._exposures[-RING:])

    def expose(self, start_ns: int, end_ns: int) -> None:
        """Record an exposure; see `BenchState`."""
        self._exposures = [*self._exposures[-RING:], ExposurePeriod(start_ns, end_ns)]

    def close(self) -> None:
        """Close nothing."""

    def _periods(self) -> tuple[tuple[LitPeriod, ...], int]:
        return self.periods(), len(self._history.lit)
