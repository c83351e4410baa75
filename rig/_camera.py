"""What a camera must be able to do for a rig."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class CameraInfo:
    """What a camera is.

    Parameters
    ----------
    vendor, model, serial
        As the camera states them.
    width, height
        Size of a frame in pixels.
    pixel_format
        Name of the format in the GenICam naming convention, for instance Mono12.
    bit_depth
        Significant bits of a sample; they sit at the low end of the 16.
    cfa
        Colour filter pattern of the first pixels, row by row ("RGGB"), None for monochrome.
    exposure_min_us, exposure_max_us
        Range of exposure times, microseconds.
    """

    vendor: str
    model: str
    serial: str
    width: int
    height: int
    pixel_format: str
    bit_depth: int
    cfa: str | None
    exposure_min_us: float
    exposure_max_us: float


@dataclass(frozen=True, eq=False)
class CameraFrame:
    """One frame, copied out of the camera's buffers.

    Parameters
    ----------
    pixels
        ``(H, W)`` uint16, raw samples aligned at the low end.
    frame_id
        The camera's own count.
    timestamp_ns
        The camera's own clock at the start of the exposure.
    exposure_us, gain_db
        What the frame was taken with, as read back from the camera.
    temperature_c
        Of the sensor, None where the camera does not tell.
    """

    pixels: npt.NDArray[np.uint16]
    frame_id: int
    timestamp_ns: int
    exposure_us: float
    gain_db: float
    temperature_c: float | None


class Camera(Protocol):
    """A camera that takes one frame per trigger. Every method raises `CameraError`."""

    @property
    def info(self) -> CameraInfo:
        """What the camera is."""

    def configure(self, *, exposure_us: float, gain_db: float = 0.0) -> float:
        """Set exposure and gain, armed or not, and return the exposure read back.

        A value outside the camera's range is refused; the message says the range.
        """

    def arm(self) -> None:
        """Make ready for triggers. Frames of earlier triggers are forgotten."""

    def trigger(self) -> int:
        """Start one exposure and return, at once, the id that its frame will carry."""

    def fetch(self, frame_id: int, timeout_s: float) -> CameraFrame:
        """Wait for the frame of this id; older ones that arrive late are thrown away.

        When it does not come in time, the message names the frame and the time waited.
        """

    def disarm(self) -> None:
        """Stop taking triggers."""

    def close(self) -> None:
        """Give the camera back; closing twice does nothing."""
