"""The time of a frame on the camera's clock."""

from __future__ import annotations

from rig._camera import CameraFrame
from rig._errors import CameraError


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
