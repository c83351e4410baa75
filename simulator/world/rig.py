"""The rig of a world, which shows the shots that it returns to independent checks."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing
from typing import Literal, cast

from rig import Rig, RigConfig, Shot
from rig.board import Board
from rig.camera import Camera


class WatchedRig(Rig):
    """A `Rig` that adds every shot that it returns to a list.

    Parameters
    ----------
    shots
        The list.
    board, camera, config, open_camera
        As for `Rig`.
    """

    def __init__(
        self,
        shots: list[Shot],
        board: Board,
        camera: Camera,
        config: RigConfig,
        open_camera: Callable[[], Camera],
    ) -> None:
        self._shots = shots
        super().__init__(board, camera, config, open_camera=open_camera)

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
        self._shots.append(shot)
        return shot

    def sequence(
        self, leds: Sequence[int | None], exposure_us: float, gain_db: float = 0.0
    ) -> Iterator[Shot]:
        """Let the board step through LEDs; see `Rig`."""
        shots = super().sequence(leds, exposure_us, gain_db)
        with closing(cast(Generator[Shot, None, None], shots)):
            for shot in shots:
                self._shots.append(shot)
                yield shot
