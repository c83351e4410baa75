"""Uncompressed TIFF files: a header, followed by the samples as they are in memory."""

from __future__ import annotations

import struct
from typing import Final

_SHORT, _LONG, _RATIONAL = 3, 4, 5
_HEADER: Final = struct.Struct("<2sHI")
_ENTRY: Final = struct.Struct("<HHIHH")
_LONG_ENTRY: Final = struct.Struct("<HHII")


def plain_tiff_header(shape: tuple[int, ...], size: int) -> bytes:
    """Return the bytes before the samples of a little-endian TIFF 6.0 file with one strip.

    Parameters
    ----------
    shape
        ``(H, W)`` or ``(H, W, 3)`` RGB.
    size
        Size of the samples that follow, in bytes.
    """
    height, width, channels = (*shape, 1)[:3]
    count = 14
    depths_at = _HEADER.size + 2 + count * _ENTRY.size + 4
    scale_at = depths_at + 8
    begin = scale_at + 8
    depth = _ENTRY.pack(258, _SHORT, 1, 16, 0)
    if channels == 3:
        depth = _LONG_ENTRY.pack(258, _SHORT, 3, depths_at)
    entries = (
        _LONG_ENTRY.pack(256, _LONG, 1, width),
        _LONG_ENTRY.pack(257, _LONG, 1, height),
        depth,
        _ENTRY.pack(259, _SHORT, 1, 1, 0),  # not compressed
        _ENTRY.pack(262, _SHORT, 1, 1 if channels == 1 else 2, 0),  # black is zero, or RGB
        _LONG_ENTRY.pack(273, _LONG, 1, begin),
        _ENTRY.pack(274, _SHORT, 1, 1, 0),  # rows from the top
        _ENTRY.pack(277, _SHORT, 1, channels, 0),
        _LONG_ENTRY.pack(278, _LONG, 1, height),
        _LONG_ENTRY.pack(279, _LONG, 1, size),
        _LONG_ENTRY.pack(282, _RATIONAL, 1, scale_at),
        _LONG_ENTRY.pack(283, _RATIONAL, 1, scale_at),
        _ENTRY.pack(284, _SHORT, 1, 1, 0),  # channels innermost
        _ENTRY.pack(296, _SHORT, 1, 1, 0),  # pixel size not known
    )
    return b"".join(
        (
            _HEADER.pack(b"II", 42, _HEADER.size),
            struct.pack("<H", count),
            *entries,
            b"\0\0\0\0",
            struct.pack("<4H", 16, 16, 16, 0),
            struct.pack("<2I", 1, 1),
        )
    )
