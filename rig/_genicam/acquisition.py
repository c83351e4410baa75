"""Starting, stopping and taking frames out of harvesters, without keeping other threads waiting."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from genicam import gentl
from harvesters.core import Callback
from harvesters.util.pfnc import symbolics

from rig._errors import CameraError
from rig._genicam.errors import told
from rig._genicam.pixels import PixelFormat, decode

# harvesters holds the interpreter's lock while it waits: so it is asked often, and never waits.
_POLL_S = 2e-5
_BIG_ENDIAN = gentl.PIXELENDIANNESS_IDS.PIXELENDIANNESS_BIG
_IMAGES = (
    gentl.PAYLOADTYPE_INFO_IDS.PAYLOAD_TYPE_IMAGE,
    gentl.PAYLOADTYPE_INFO_IDS.PAYLOAD_TYPE_CHUNK_DATA,
)


class IncompleteFrameError(CameraError):
    """A frame arrived in part only."""


@dataclass(frozen=True, eq=False)
class ReceivedFrame:
    """A whole frame out of a buffer.

    Parameters
    ----------
    block
        The device's own count.
    timestamp_ns
        The device's own clock, 0 where it does not tell.
    pixels
        ``(H, W)`` uint16.
    """

    block: int
    timestamp_ns: int
    pixels: npt.NDArray[np.uint16]


class _Heard(Callback):  # type: ignore[misc] # harvesters has no types
    """Remembers that harvesters threw a buffer away: it does not say so otherwise."""

    def __init__(self) -> None:
        self.incomplete = False

    def emit(self, context: object | None = None) -> None:
        self.incomplete = True


class Acquisition:
    """The stream of frames of a camera.

    Parameters
    ----------
    acquirer
        harvesters' ``ImageAcquirer``.
    camera
        What messages call the camera.

    Raises
    ------
    CameraError
        If the camera has not exactly one stream.
    """

    def __init__(self, acquirer: Any, camera: str) -> None:
        self._acquirer = acquirer
        self._camera = camera
        self._heard = _Heard()
        self._running = False
        self._form: PixelFormat | None = None
        self._size = (0, 0)
        if (streams := len(acquirer.data_streams)) != 1:
            raise CameraError(f"camera {camera} has {streams} data streams, wanted is one")
        acquirer.add_callback(acquirer.Events.INCOMPLETE_BUFFER, self._heard)
        acquirer.timeout_period_on_update_event_data_call = 0

    @property
    def running(self) -> bool:
        """Whether frames can come."""
        return self._running

    def expect(self, form: PixelFormat, size: tuple[int, int]) -> None:
        """State the format and (H, W) that frames are to have."""
        self._form = form
        self._size = size

    def start(self) -> None:
        """Start with all buffers empty."""
        with told(f"camera {self._camera}, start of acquisition"):
            self._acquirer.start()
        self._running = True

    def stop(self) -> None:
        """Stop, and throw away whatever has not been taken."""
        self._running = False
        with told(f"camera {self._camera}, end of acquisition"):
            self._acquirer.stop()

    def poll(self) -> ReceivedFrame | None:
        """Return the next frame, None where there is none at this moment.

        Raises
        ------
        IncompleteFrameError
            If one arrived in part; its buffer waits for another again.
        CameraError
            If the camera does not answer, or a frame is not what was expected.
        """
        self._heard.incomplete = False
        with told(f"camera {self._camera}, awaiting a frame"):
            buffer = self._acquirer.try_fetch(timeout=_POLL_S, is_raw=True)
            if buffer is None:
                if self._heard.incomplete:
                    raise IncompleteFrameError(f"camera {self._camera}: a frame arrived in part")
                return None
            try:
                return self._received(buffer)
            finally:
                buffer.parent.queue_buffer(buffer)

    def _received(self, buffer: Any) -> ReceivedFrame:
        if buffer.payload_type not in _IMAGES:
            raise CameraError(
                f"camera {self._camera}: its buffers hold payload of type {buffer.payload_type}, "
                "not images; turn multi-part, compressed and 3D payloads off"
            )
        form = self._form
        name = symbolics.get(int(buffer.pixel_format), hex(int(buffer.pixel_format)))
        size = int(buffer.height), int(buffer.width)
        if form is None or name != form.name or size != self._size:
            raise CameraError(
                f"camera {self._camera}: a frame of {size[1]} x {size[0]} pixels in {name} came, "
                f"set is {self._size[1]} x {self._size[0]} in {form.name if form else 'nothing'}; "
                "open the camera again"
            )
        filled = int(_told_or(buffer, "size_filled", len(buffer.raw_buffer)))
        start = int(_told_or(buffer, "image_offset", 0))
        return ReceivedFrame(
            int(buffer.frame_id),
            _timestamp_ns(buffer),
            decode(
                memoryview(buffer.raw_buffer)[start:filled],
                form,
                size=size,
                padding=int(_told_or(buffer, "padding_x", 0)),
                big_endian=_told_or(buffer, "pixel_endianness", None) == _BIG_ENDIAN,
                camera=self._camera,
            ),
        )


def _told_or(buffer: Any, name: str, default: Any) -> Any:
    """Return what the producer tells of a buffer, or the default where it need not and does not."""
    try:
        return getattr(buffer, name)
    except gentl.GenericException:
        return default


def _timestamp_ns(buffer: Any) -> int:
    stated = _told_or(buffer, "timestamp_ns", None)
    if stated is not None:
        return int(stated)
    ticks = int(_told_or(buffer, "timestamp", 0))
    frequency_hz = int(_told_or(buffer.parent.parent, "timestamp_frequency", 0))
    return ticks * 1_000_000_000 // frequency_hz if frequency_hz else 0
