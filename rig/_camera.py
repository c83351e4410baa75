"""What a camera must be able to do for a rig."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt

Trigger = Literal["software", "line"]


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
    shutter
        "rolling" where the rows are exposed one after the other.
    readout_us
        With a rolling shutter, the time from the start of the first row's exposure to that of the
        last row's: the light has to cover the exposure and this. 0 with a global shutter.
    trigger_delay_us
        From the trigger to the start of the exposure.
    frame_period_us
        Least time between two triggers at the exposure set last, 0 where it is not known.
    turned_off
        What the camera did to its pictures by itself until it was opened: names of nodes.
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
    shutter: Literal["global", "rolling"] = "global"
    readout_us: float = 0.0
    trigger_delay_us: float = 0.0
    frame_period_us: float = 0.0
    turned_off: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class CameraFrame:
    """One frame, copied out of the camera's buffers.

    Parameters
    ----------
    pixels
        ``(H, W)`` uint16, raw samples aligned at the low end.
    frame_id
        The count of triggers since the camera was opened, checked against the device's own.
    timestamp_ns
        The camera's own clock at the start of the exposure; 0 where it tells no time.
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
    """A camera that takes one frame per trigger. Every method raises `CameraError`.

    Ids count triggers from 0 while the camera is open, whatever the device's own count does. After
    a failed `fetch` all that is under way is drained before the next trigger: the frame of one
    trigger is never taken for that of another.
    """

    @property
    def info(self) -> CameraInfo:
        """What the camera is."""

    def configure(self, *, exposure_us: float, gain_db: float = 0.0) -> float:
        """Set exposure and gain, armed or not, and return the exposure read back.

        A value outside the camera's range is refused; the message says the range.
        """

    def arm(self, trigger: Trigger = "software", frames: int = 1) -> None:
        """Make ready for triggers of one kind. Frames of earlier triggers are forgotten.

        ``frames`` is how many may be under way at once: the camera keeps room for so many, as far
        as memory allows. Left out by callers that need only one.
        """

    def trigger(self) -> int:
        """Start one exposure by software and return, at once, the id that its frame will carry."""

    def expect(self) -> int:
        """Announce one pulse on the trigger line and return the id that its frame must carry.

        May be called several times ahead; the pulses then belong to the ids in their order. Only
        pulses after `arm`, or after the first `expect` that follows a failed `fetch`, count.
        """

    def fetch(
        self, frame_id: int, timeout_s: float, waiting: Callable[[], None] | None = None
    ) -> CameraFrame:
        """Wait for the frame of this id; older ones that arrive late are thrown away.

        When it does not come in time, the message names the frame, the time waited and, where the
        trigger is a line, the line. ``waiting`` is called at least every 200 ms meanwhile; what it
        raises ends the wait. Until the next trigger the same frame may be asked for again.
        """

    def disarm(self) -> None:
        """Stop taking triggers."""

    def close(self) -> None:
        """Give the camera back; closing twice does nothing."""
