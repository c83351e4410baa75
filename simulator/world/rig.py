"""The rig of a world, which shows the shots that it returns to independent checks."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from typing import Literal, cast

from rig import Rig, Shot


class WatchedRig(Rig):
    """A `Rig` that notes every shot that it returns.

    Attributes
    ----------
    shots
        The list to which they are added; to be set before the first one.
    """

    shots: list[Shot]

    def shoot(
        self,
        led: int | None,
        exposure_us: float,
        gain_db: float = 0.0,
        *,
        trigger: Literal["software", "board"] | None = None,
    ) -> Shot:
        """Take one frame; see `Rig`."""
        shot = super().shoot(led, exposure_us, gain_db, trigger=trigger)
        self.shots.append(shot)
        return shot

    def sequence(
        self, leds: Sequence[int | None], exposure_us: float, gain_db: float = 0.0
    ) -> Iterator[Shot]:
        """Let the board step through LEDs; see `Rig`."""
        shots = super().sequence(leds, exposure_us, gain_db)
        with closing(cast(Generator[Shot, None, None], shots)):
            for shot in shots:
                self.shots.append(shot)
                yield shot
