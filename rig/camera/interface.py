"""The interface that a rig requires of a camera."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol

from rig.arrays import UInt16
from rig.messages.representation import short_repr

Trigger = Literal["software", "line"]


@dataclass(frozen=True)
class CameraInfo:
    """Identity and properties of a camera.

    Parameters
    ----------
    vendor, model, serial
        As the camera reports them.
    width, height
        Size of a frame in pixels.
    pixel_format
        Name of the format in the GenICam naming convention, for instance Mono12.
    bit_depth
        Significant bits of a sample; they are the low bits of the 16.
    cfa
        Colour filter pattern of the first pixels, row by row ("RGGB"), None for monochrome.
    exposure_min_us, exposure_max_us
        Range of exposure times, microseconds.
    shutter
        "rolling" if the rows are exposed one after the other.
    readout_us
        With a rolling shutter, the time from the start of the first row's exposure to the start of
        the last row's: the light has to cover the exposure plus this time. 0 with a global shutter.
    trigger_delay_us
        Time from the trigger to the start of the exposure.
    frame_period_us
        Least time between two triggers at the current exposure time, 0 if it is not known.
    turned_off
        Names of the nodes for image processing in the camera that were on when it was opened.
    settings
        The other settings of the camera after it was set up, by the names of their nodes.
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
    settings: Mapping[str, bool | int | float | str] = field(default_factory=dict, hash=False)

    @property
    def white_dn(self) -> int:
        """Largest raw value of this bit depth; a sample of this value is saturated."""
        return int(2**self.bit_depth - 1)

    def __repr__(self) -> str:
        name = " ".join(filter(None, (self.vendor, self.model, self.serial)))
        return f"CameraInfo({name}, {self.width} x {self.height} px, {self.pixel_format})"


@dataclass(frozen=True, eq=False)
class CameraFrame:
    """One frame, copied out of the camera's buffers.

    Parameters
    ----------
    pixels
        ``(H, W)`` uint16, raw samples in the low bits.
    frame_id
        Number of the trigger since the camera was opened, checked against the device's own count.
    timestamp_ns
        The camera's own clock at the start of the exposure; 0 if it reports no time.
    exposure_us, gain_db
        Exposure time and gain of the frame, as read back from the camera.
    temperature_c
        Temperature of the sensor, None if the camera does not report it.
    """

    pixels: UInt16
    frame_id: int
    timestamp_ns: int
    exposure_us: float
    gain_db: float
    temperature_c: float | None

    __repr__ = short_repr


class Camera(Protocol):
    """A camera that takes one frame per trigger. Every method raises `CameraError`.

    Ids count triggers from 0 while the camera is open, independently of the device's own count.
    After a failed `fetch` all pending frames are discarded before the next trigger, so that the
    frame of one trigger is never mistaken for that of another.
    """

    @property
    def info(self) -> CameraInfo:
        """Identity and properties of the camera."""

    def configure(self, *, exposure_us: float, gain_db: float = 0.0) -> float:
        """Set exposure time and gain, armed or not, and return the exposure time as read back.

        A value outside the camera's range is refused; the message states the range.
        """

    def arm(self, trigger: Trigger = "software", frames: int = 1) -> None:
        """Prepare for triggers of one kind. Frames of earlier triggers are discarded.

        ``frames`` is the number of frames that may be pending at once: the camera reserves room for
        them as far as memory allows.
        """

    def trigger(self) -> int:
        """Start one exposure by software and return at once the id that its frame will have."""

    def expect(self) -> int:
        """Announce one pulse on the trigger line and return the id that its frame must have.

        It may be called several times in advance; the pulses then belong to the ids in their order.
        Only pulses after `arm`, or after the first `expect` that follows a failed `fetch`, count.
        """

    def fetch(
        self, frame_id: int, timeout_s: float, waiting: Callable[[], None] | None = None
    ) -> CameraFrame:
        """Wait for the frame with this id; older frames that arrive late are discarded.

        If it does not arrive in time, the message names the frame, the time waited and, if the
        trigger is a line, the line. ``waiting`` is called at least every 200 ms meanwhile; an
        exception from it ends the wait. The same frame may be requested again until the next
        trigger.
        """

    def disarm(self) -> None:
        """Stop accepting triggers."""

    def close(self) -> None:
        """Release the camera; closing twice does nothing."""
