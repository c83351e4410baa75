"""Integrity check for PNG files, made before decoding: the decoder prints errors to stderr."""

from __future__ import annotations

import zlib

from acquisition._errors import DataError

SIGNATURE = b"\x89PNG\r\n\x1a\n"


def check_png(data: bytes, name: str) -> None:
    """Check the CRC of every chunk of a PNG file up to its end chunk.

    The decoder accepts a file that stops after its last pixels, and the encoder does not notice a
    full disk; this check finds both. Bytes after the end chunk are allowed.

    Raises
    ------
    DataError
        If a chunk is truncated or altered, or the end chunk is missing.
    """
    position = len(SIGNATURE)
    view = memoryview(data)
    while True:
        length = int.from_bytes(view[position : position + 4])
        kind = view[position + 4 : position + 8]
        end = position + 8 + length
        crc = view[end : end + 4]
        if len(crc) < 4:
            raise DataError(f"{name}: PNG cut short at byte {len(data)}: copy it again")
        if zlib.crc32(view[position + 4 : end]) != int.from_bytes(crc):
            raise DataError(f"{name}: PNG damaged in the chunk at byte {position}: copy it again")
        if bytes(kind) == b"IEND":
            return
        position = end + 4
