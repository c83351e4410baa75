"""The proof that a frame of a run belongs to its trigger: both clocks tell the same spacing."""

from __future__ import annotations

from rig._camera import CameraFrame
from rig._errors import FrameLostError
from rig._shooting.exposure import CLOCK_JITTER_US, CLOCK_SHARE
from rig._shooting.frame_time import time_ns
from rig._shooting.shot import led_name


class Spacing:
    """Compares frames on the camera's clock with triggers on the board's, one after the other.

    A trigger that the camera missed, or a pulse that it saw and the board did not send, moves every
    later frame by one while all counts still agree. It shows as a wrong time to the frame before,
    and, since the first gap of a run is longer than the others, also where it was the first.

    Parameters
    ----------
    camera
        The camera's name, for messages.
    """

    def __init__(self, camera: str) -> None:
        self._camera = camera
        # Frame id, and the time of exposure and trigger in microseconds, of the first and the last.
        self._taken: list[tuple[int, float, float]] = []

    def check(self, frame: CameraFrame, led: int | None, trigger_us: int) -> None:
        """Take the next frame of the run.

        Parameters
        ----------
        frame
            As the camera delivered it.
        led
            Whose turn it is, for the message.
        trigger_us
            When the board pulsed the line for it.

        Raises
        ------
        FrameLostError
            If the time from the frame before it, or from the first one, is not that between their
            triggers.
        CameraError
            If the camera reports no time.
        """
        frame_us = time_ns(frame, self._camera) / 1000
        for frame_id, taken_us, pulsed_us in self._taken:
            apart_us, pulses_us = frame_us - taken_us, trigger_us - pulsed_us
            if abs(apart_us - pulses_us) > CLOCK_JITTER_US + CLOCK_SHARE * pulses_us:
                raise FrameLostError(
                    f"camera {self._camera}: frame {frame.frame_id}, the turn of {led_name(led)}, "
                    f"was exposed {apart_us:.0f} us after frame {frame_id}, their triggers were "
                    f"{pulses_us:.0f} us apart: a trigger was missed or one too many seen, and the "
                    "frame is thrown away; check the trigger wire, raise frame_period_ms in the "
                    "rig file, and take the sequence again"
                )
        self._taken[1:] = [(frame.frame_id, frame_us, float(trigger_us))]
