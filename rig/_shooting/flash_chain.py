"""The proof that the frame of a single flash belongs to its trigger."""

from __future__ import annotations

import time

from rig._camera import CameraFrame
from rig._errors import CameraError, FrameLostError
from rig._shooting.frame_time import time_ns
from rig._shooting.shot import led_name
from rig._shooting.shot_times import CLOCK_JITTER_US, CLOCK_SHARE, ShotTimes

# Drift of the ratio of the two clocks' rates while a rig is open.
_DRIFT_SHARE = 1e-4


class FlashChain:
    """Compares each flash with the previous one, on the camera's clock and on the board's.

    Noise on the trigger line also produces a frame, and a camera that is busy with it misses the
    real trigger: there is one frame for one trigger, but it was exposed without the light. Its time
    reveals this.

    Parameters
    ----------
    camera
        The camera's name, for messages.
    """

    def __init__(self, camera: str) -> None:
        self._camera = camera
        self._last_ns: int | None = None
        self._last_s = 0.0
        # Time from the first link to the last on either clock: the ratio of their rates.
        self._frames_us = self._pulses_us = 0.0

    def reaches(self, times: ShotTimes) -> bool:
        """Return whether a flash now would be soon enough after the last one to be verified.

        The longer ago the last flash was, the less the two clocks agree; the margin of the light
        has to cover this uncertainty.
        """
        since_us = (time.monotonic() - self._last_s) * 1e6 + times.period_us
        return self._last_ns is not None and self._open_us(since_us) <= times.margin_us

    def begin(self, frame: CameraFrame) -> None:
        """Start with a frame that is not proven itself and must not be used otherwise.

        Raises
        ------
        CameraError
            If the camera reports no time.
        """
        self._frames_us = self._pulses_us = 0.0
        self._link(frame)

    def cut(self) -> None:
        """Forget the last frame: unknown frames or triggers may have followed it."""
        self._last_ns = None

    def check(
        self, frame: CameraFrame, led: int | None, since_us: int | None, times: ShotTimes
    ) -> None:
        """Check the next frame.

        Parameters
        ----------
        frame
            Frame as the camera delivered it.
        led
            LED of the flash, for the message.
        since_us
            Time from the previous trigger to this one, by the board's clock.
        times
            Times of the shot.

        Raises
        ------
        FrameLostError
            If the time since the previous frame is not that between their triggers.
        CameraError
            If the camera reports no time, or the board has restarted.
        """
        last_ns = self._last_ns
        self.cut()
        where = f"camera {self._camera}: frame {frame.frame_id}, the flash of {led_name(led)},"
        if last_ns is None or since_us is None:
            raise CameraError(
                f"{where} cannot be compared with the previous one, because the board has "
                "restarted; the frame is discarded, shoot again"
            )
        apart_us = (time_ns(frame, self._camera) - last_ns) / 1000
        off_us = abs(apart_us - self._rate * since_us)
        if off_us > min(self._open_us(since_us), times.margin_us):
            raise FrameLostError(
                f"{where} was exposed {apart_us:.0f} us after the previous one, but their triggers "
                f"were {since_us} us apart: something else triggered the camera, and the frame is "
                "discarded; check the trigger wire for noise, and shoot again"
            )
        self._frames_us += apart_us
        self._pulses_us += since_us
        self._link(frame)

    def _link(self, frame: CameraFrame) -> None:
        self._last_ns = time_ns(frame, self._camera)
        self._last_s = time.monotonic()

    @property
    def _rate(self) -> float:
        """Ratio of camera time to board time; 1 until it is known better than the clocks' specs."""
        known = self._unsure < CLOCK_SHARE
        return self._frames_us / self._pulses_us if known else 1.0

    @property
    def _unsure(self) -> float:
        """Uncertainty of the rate."""
        if not self._pulses_us:
            return CLOCK_SHARE
        return min(CLOCK_SHARE, 2 * CLOCK_JITTER_US / self._pulses_us + _DRIFT_SHARE)

    def _open_us(self, since_us: float) -> float:
        """Return the uncertainty of a frame's time, this long after the last frame."""
        return CLOCK_JITTER_US + self._unsure * since_us
