"""Chunks of PNG files, and their check before decoding: the decoder prints errors to stderr."""

from __future__ import annotations

import struct
import zlib
from typing import BinaryIO

from acquisition._errors import DataError

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PART = 1 << 18


def chunk(kind: bytes, data: bytes) -> bytes:
    """Return a complete chunk: length, kind, data and CRC."""
    head = struct.pack(">I", len(data)) + kind
    return b"".join((head, data, struct.pack(">I", zlib.crc32(data, zlib.crc32(kind)))))


# The sRGB curve, relative colorimetric, and its approximation for programs that only know gamma:
# PNG 3, 11.3.2.2 and 11.3.2.5.
SRGB_CHUNKS = (chunk(b"sRGB", b"\1"), chunk(b"gAMA", struct.pack(">I", 45455)))


def check_png(file: BinaryIO, name: str) -> None:
    """Check the CRC of every chunk of a PNG file up to its end chunk.

    The decoder accepts a file that stops after its last pixels, and the encoder does not notice a
    full disk; this check finds both. Bytes after the end chunk are allowed.

    Parameters
    ----------
    file
        The file, at its begin. It is read in parts, because it may be large.
    name
        Its name, for messages.

    Raises
    ------
    DataError
        If a chunk is truncated or altered, or the end chunk is missing.
    """
    position = len(file.read(len(SIGNATURE)))
    while True:
        head = file.read(8)
        left, crc = int.from_bytes(head[:4]), zlib.crc32(head[4:])
        size = len(head)
        while left and (part := file.read(min(left, _PART))):
            left, crc, size = left - len(part), zlib.crc32(part, crc), size + len(part)
        stored = file.read(4)
        if len(head) < 8 or len(stored) < 4:
            end = position + size + len(stored)
            raise DataError(f"{name}: PNG cut short at byte {end}: copy it again")
        if crc != int.from_bytes(stored):
            raise DataError(f"{name}: PNG damaged in the chunk at byte {position}: copy it again")
        if head[4:] == b"IEND":
            return
        position += size + 4
