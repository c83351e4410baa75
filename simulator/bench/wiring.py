"""Wrongly wired LEDs: the LEDs that are on when the board turns one on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from acquisition import DataError, MapRows

Planes = Callable[[int | None], MapRows]


@dataclass(frozen=True)
class Wiring:
    """Wiring faults between the board and its LEDs; the default has none.

    Parameters
    ----------
    swapped
        Pairs of LEDs that are swapped: each is on in place of the other.
    double
        Pairs of LEDs that are always on together.
    always
        LEDs that are always on.

    Raises
    ------
    DataError
        If an LED is listed more than once, or its number is negative.
    """

    swapped: tuple[tuple[int, int], ...] = ()
    double: tuple[tuple[int, int], ...] = ()
    always: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if len(set(self.leds)) < len(self.leds) or any(led < 0 for led in self.leds):
            raise DataError(
                "LED numbers in swapped, double and always must not be negative, and each LED may "
                "be listed only once"
            )

    @property
    def leds(self) -> tuple[int, ...]:
        """All LEDs that are wired wrongly."""
        pairs = (*self.swapped, *self.double)
        return (*(led for pair in pairs for led in pair), *self.always)

    def planes(self, planes: Planes) -> Planes:
        """Return the planes that the camera sees with this wiring."""
        other = {a: b for one, two in self.swapped for a, b in ((one, two), (two, one))}
        both = {a: b for one, two in self.double for a, b in ((one, two), (two, one))}

        def seen(led: int | None) -> MapRows:
            if led is None:
                glow = planes(None)[:]
                for lit in self.always:
                    glow = glow + planes(lit)[:]
                return glow
            if led in self.always:
                return np.zeros_like(planes(led)[:])
            plane = planes(other.get(led, led))
            return plane[:] + planes(both[led])[:] if led in both else plane

        return seen if self.leds else planes
