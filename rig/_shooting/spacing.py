"""The proof that a frame of a run belongs to its trigger: equal spacing on both clocks."""

from __future__ import annotations

from rig._camera import CameraFrame
from rig._errors import FrameLostError
from rig._shooting.frame_time import time_ns
from rig._shooting.shot import led_name
from rig._shooting.shot_times import CLOCK_JITTER_US, CLOCK_SHARE


class Spacing:
    """Compares frames on the camera's clock with triggers on the board's clock, in order.

    A trigger that the camera missed, or a pulse that it saw but the board did not send, shifts
    every later frame by one while all counts still agree. The time to the previous frame is then
    wrong. Since the first gap of a run is longer than the others, this also detects the loss of the
    first frame.

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
