"""Times of an exposure: how long the LED must be on, and how soon the next one may begin."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from rig._errors import RigError
from rig.board.values import BoardIdentity, Step
from rig.camera.interface import CameraInfo
from rig.config.rig_file import RigConfig

# Relative difference of the board's and the camera's clock: ceramic resonators are good to 0.5 %.
CLOCK_SHARE = 0.01
# Uncertainty of the time of an event on either clock.
CLOCK_JITTER_US = 300.0
# A run this long stays within half a period on both clocks.
LONGEST_RUN = 48
# The second gap is longer than the later ones by this share, and by at least 5 ms, and the first by
# twice as much, so that a run that begins with another frame looks different: see `Spacing`.
_LONGER_SHARE = 0.05
_LONGER_US = 5000
_LONGEST_GAP_US = 1_000_000
# Time between two flashes in addition to the camera's own time.
_BETWEEN_US = 20_000
# Time between triggers for a camera that does not report its speed.
_UNKNOWN_PERIOD_US = 100_000.0


@dataclass(frozen=True)
class ShotTimes:
    """The times of one shot, microseconds.

    Parameters
    ----------
    settle_us
        Time from turning the LED on to the trigger.
    needed_us
        Time from the trigger to the end of the last row's exposure, while the LED must be on.
    period_us
        Least time from trigger to trigger, as far as it is known.
    run_us
        Time from trigger to trigger in a sequence, which does not wait for frames.
    """

    settle_us: int
    needed_us: float
    period_us: float
    run_us: float

    @classmethod
    def of(cls, info: CameraInfo, config: RigConfig, exposure_us: float) -> ShotTimes:
        """Return the times for a camera, a rig and an exposure time."""
        needed_us = info.trigger_delay_us + exposure_us + info.readout_us
        stated_us = max(info.frame_period_us, config.frame_period_ms * 1000)
        period_us = max(stated_us, needed_us)
        run_us = period_us if stated_us else needed_us + _UNKNOWN_PERIOD_US
        # The board's clock may be too fast for the camera.
        run_us = run_us * (1 + CLOCK_SHARE) + CLOCK_JITTER_US
        return cls(math.ceil(config.settle_ms * 1000), needed_us, period_us, run_us)

    @property
    def margin_us(self) -> float:
        """Largest time between a trigger and its exposure that the timestamps cannot detect.

        The LED of a flash is on for this much longer before and after the exposure, and frames with
        a larger difference are refused: see `FlashChain` and `Spacing`.
        """
        return CLOCK_JITTER_US + CLOCK_SHARE * (2 * self.period_us + _BETWEEN_US)

    @property
    def ahead_us(self) -> int:
        """Time from turning the LED of a flash on to its trigger: settling time or the margin."""
        return min(max(self.settle_us, math.ceil(self.margin_us)), _LONGEST_GAP_US)

    @property
    def hold_us(self) -> int:
        """Time for which the LED of a flash stays on after its trigger."""
        return math.ceil(self.needed_us * (1 + CLOCK_SHARE) + self.margin_us)

    def check(self, board: BoardIdentity) -> None:
        """Refuse a flash that is longer than the board can keep an LED on.

        Raises
        ------
        RigError
            If it is too long.
        """
        needed_ms = (self.ahead_us + self.hold_us) / 1000
        if needed_ms > board.max_hold_ms:
            raise RigError(
                f"an exposure that needs light for {needed_ms:.0f} ms is longer than the "
                f"{board.max_hold_ms} ms that this LED board allows: expose shorter"
            )

    def steps(self, leds: tuple[int | None, ...]) -> Iterator[Step]:
        """Yield the steps of a run over these LEDs.

        Raises
        ------
        RigError
            If the camera is too slow for a sequence.
        """
        lit_us = self.ahead_us + self.hold_us
        gap_us = max(0, math.ceil(self.run_us) - lit_us)
        longer_us = max(_LONGER_US, math.ceil(_LONGER_SHARE * (lit_us + gap_us)))
        if gap_us + 2 * longer_us > _LONGEST_GAP_US:
            raise RigError(
                f"the camera takes only one frame every {self.run_us / 1e6:.2f} s, which is too "
                "slow for a sequence: take single shots"
            )
        last = len(leds) - 1
        for index, led in enumerate(leds):
            after_us = 0 if index == last else gap_us + max(0, 2 - index) * longer_us
            yield Step(led, self.ahead_us, self.hold_us, after_us)
