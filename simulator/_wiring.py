"""LEDs wired wrongly: which lights really burn when the board believes that one does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition import DataError

Planes = Callable[[int | None], npt.NDArray[np.float32]]


@dataclass(frozen=True)
class Wiring:
    """What is wrong between the board and its LEDs; the default is nothing.

    Parameters
    ----------
    swapped
        Pairs of LEDs of which each burns in place of the other.
    double
        Pairs of LEDs that burn together, whichever is asked for.
    always
        LEDs that burn all the time.

    Raises
    ------
    DataError
        If an LED is in more than one place of these.
    """

    swapped: tuple[tuple[int, int], ...] = ()
    double: tuple[tuple[int, int], ...] = ()
    always: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if len(set(self.leds)) < len(self.leds) or any(led < 0 for led in self.leds):
            raise DataError(
                "an LED counts from 0 and is swapped, double or always on, one of these and once"
            )

    @property
    def leds(self) -> tuple[int, ...]:
        """Every LED that is wired wrongly."""
        pairs = (*self.swapped, *self.double)
        return (*(led for pair in pairs for led in pair), *self.always)

    def planes(self, planes: Planes) -> Planes:
        """Return what the camera sees of lights that are wired so."""
        other = {a: b for one, two in self.swapped for a, b in ((one, two), (two, one))}
        both = {a: b for one, two in self.double for a, b in ((one, two), (two, one))}

        def seen(led: int | None) -> npt.NDArray[np.float32]:
            if led is None:
                glow = planes(None)
                for burning in self.always:
                    glow = glow + planes(burning)
                return glow
            if led in self.always:
                return np.zeros_like(planes(led))
            plane = planes(other.get(led, led))
            return plane + planes(both[led]) if led in both else plane

        return seen if self.leds else planes
