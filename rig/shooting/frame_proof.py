"""The proof that a frame belongs to its trigger: times of flashes and runs on both clocks."""

from __future__ import annotations

from rig._errors import CameraError, FrameLostError
from rig.camera.interface import CameraFrame
from rig.host import clock
from rig.shooting.shot import led_name
from rig.shooting.shot_times import CLOCK_JITTER_US, CLOCK_SHARE, ShotTimes

# Drift of the ratio of the two clocks' rates while a rig is open.
_DRIFT_SHARE = 1e-4


def time_ns(frame: CameraFrame, camera: str) -> int:
    """Return the time of a frame, which proves to which trigger it belongs.

    Parameters
    ----------
    frame
        Frame as the camera delivered it.
    camera
        The camera's name, for the message.

    Raises
    ------
    CameraError
        If the camera reports no time.
    """
    if frame.timestamp_ns == 0:
        raise CameraError(
            f"camera {camera}: frame {frame.frame_id} arrived without a time, and nothing else "
            "proves to which trigger of the board it belongs; the camera reports no time: use "
            'trigger = "software" in the rig file, and no sequences'
        )
    return frame.timestamp_ns


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
        since_us = (clock.monotonic() - self._last_s) * 1e6 + times.period_us
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
        self._last_s = clock.monotonic()

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


class Spacing:
    """Compares frames on the camera's clock with triggers on the board's clock, in order.

    A trigger that the camera missed, or a pulse that it saw but the board did not send, shifts
    every later frame by one while all counts still agree. The time to the previous frame is then
    wrong. The first two gaps of a run differ from each other and from the later ones, so that the
    third frame proves the first two: another pulse at the right distance before the second one, in
    place of a lost trigger or before the first, is then seen.

    Parameters
    ----------
    camera
        The camera's name, for messages.
    """

    def __init__(self, camera: str) -> None:
        self._camera = camera
        # Frame id, and the times of frame and trigger in µs, of the first and the last frame.
        self._taken: list[tuple[int, float, float]] = []

    def check(self, frame: CameraFrame, led: int | None, trigger_us: int) -> None:
        """Check the next frame of the run.

        Parameters
        ----------
        frame
            Frame as the camera delivered it.
        led
            LED of the step, for the message.
        trigger_us
            When the board pulsed the line for this frame.

        Raises
        ------
        FrameLostError
            If the time from the previous frame, or from the first one, is not that between their
            triggers.
        CameraError
            If the camera reports no time.
        """
        frame_us = time_ns(frame, self._camera) / 1000
        for frame_id, taken_us, pulsed_us in self._taken:
            apart_us, pulses_us = frame_us - taken_us, trigger_us - pulsed_us
            if abs(apart_us - pulses_us) > CLOCK_JITTER_US + CLOCK_SHARE * pulses_us:
                raise FrameLostError(
                    f"camera {self._camera}: frame {frame.frame_id}, the step of {led_name(led)}, "
                    f"was exposed {apart_us:.0f} us after frame {frame_id}, but their triggers "
                    f"were {pulses_us:.0f} us apart: the camera missed a trigger or saw an extra "
                    "one, and the frame is discarded; check the trigger wire, raise "
                    "frame_period_ms in the rig file, and take the sequence again"
                )
        self._taken[1:] = [(frame.frame_id, frame_us, float(trigger_us))]
