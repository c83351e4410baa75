"""The content of a filled buffer: as received, as a copy, and as a frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from genicam import gentl
from harvesters.util.pfnc import symbolics

from rig._errors import CameraError
from rig.arrays import UInt16
from rig.genicam.pixels import PixelFormat, decode

_BIG_ENDIAN = gentl.PIXELENDIANNESS_IDS.PIXELENDIANNESS_BIG
_IMAGES = (
    gentl.PAYLOADTYPE_INFO_IDS.PAYLOAD_TYPE_IMAGE,
    gentl.PAYLOADTYPE_INFO_IDS.PAYLOAD_TYPE_CHUNK_DATA,
)


@dataclass(frozen=True, eq=False)
class ReceivedFrame:
    """A complete frame from a buffer.

    Parameters
    ----------
    block
        Block id: the device's own count.
    timestamp_ns
        Time on the device's own clock, 0 if it does not report one.
    pixels
        ``(H, W)`` uint16.
    """

    block: int
    timestamp_ns: int
    pixels: UInt16


@dataclass(frozen=True, eq=False)
class Content:
    """The content of a buffer, not decoded yet.

    Parameters
    ----------
    block, timestamp_ns
        See `ReceivedFrame`.
    payload_type
        GenTL's number of the payload type.
    format
        Name of the pixel format.
    size
        (H, W).
    padding
        Bytes after each row.
    big_endian
        Byte order of samples of two bytes.
    raw
        Bytes from the image's first byte on.
    """

    block: int
    timestamp_ns: int
    payload_type: int
    format: str
    size: tuple[int, int]
    padding: int
    big_endian: bool
    raw: memoryview

    @classmethod
    def of(cls, buffer: Any) -> Content:
        """Return a view of genicam's ``Buffer``, valid until the buffer is queued again."""
        filled = int(_stated_or(buffer, "size_filled", len(buffer.raw_buffer)))
        start = int(_stated_or(buffer, "image_offset", 0))
        pixel_format = int(buffer.pixel_format)
        return cls(
            block=int(buffer.frame_id),
            timestamp_ns=_timestamp_ns(buffer),
            payload_type=buffer.payload_type,
            format=symbolics.get(pixel_format, hex(pixel_format)),
            size=(int(buffer.height), int(buffer.width)),
            padding=int(_stated_or(buffer, "padding_x", 0)),
            big_endian=_stated_or(buffer, "pixel_endianness", None) == _BIG_ENDIAN,
            raw=memoryview(buffer.raw_buffer)[start:filled],
        )

    def copied(self) -> Content:
        """Return a copy with its own memory."""
        # Not bytes(): copying an array lets other threads run.
        return replace(self, raw=np.frombuffer(self.raw, np.uint8).copy().data)

    def frame(self, form: PixelFormat | None, size: tuple[int, int], camera: str) -> ReceivedFrame:
        """Return the frame.

        Parameters
        ----------
        form, size
            Format and (H, W) that the frame must have.
        camera
            Name of the camera in messages.

        Raises
        ------
        CameraError
            If the content is not an image of this format and size.
        """
        if self.payload_type not in _IMAGES:
            raise CameraError(
                f"camera {camera}: its buffers hold payload of type {self.payload_type}, "
                "not images; turn multi-part, compressed and 3D payloads off"
            )
        if form is None or self.format != form.name or self.size != size:
            raise CameraError(
                f"camera {camera}: a frame has {self.size[1]} x {self.size[0]} pixels in "
                f"{self.format}, but {size[1]} x {size[0]} in "
                f"{form.name if form else 'no format'} was set; open the camera again"
            )
        pixels = decode(
            self.raw,
            form,
            size=size,
            padding=self.padding,
            big_endian=self.big_endian,
            camera=camera,
        )
        return ReceivedFrame(self.block, self.timestamp_ns, pixels)


def _stated_or(buffer: Any, name: str, default: Any) -> Any:
    """Return an optional property of a buffer, the default if the producer does not state it."""
    try:
        return getattr(buffer, name)
    except gentl.GenericException:
        return default


def _timestamp_ns(buffer: Any) -> int:
    stated = _stated_or(buffer, "timestamp_ns", None)
    if stated is not None:
        return int(stated)
    ticks = int(_stated_or(buffer, "timestamp", 0))
    frequency_hz = int(_stated_or(buffer.parent.parent, "timestamp_frequency", 0))
    return ticks * 1_000_000_000 // frequency_hz if frequency_hz else 0
