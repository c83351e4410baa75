"""The file of a fresh frame: uncompressed TIFF, written straight from the array, safe on disk."""

from __future__ import annotations

import hashlib
import os
import struct
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from acquisition._storage import disk, part_path, publish

_SHORT, _LONG, _RATIONAL = 3, 4, 5
_HEADER: Final = struct.Struct("<2sHI")
_ENTRY: Final = struct.Struct("<HHIHH")
_LONG_ENTRY: Final = struct.Struct("<HHII")
# Pieces that are hashed while they are still in the cache.
_PIECE: Final = 1 << 20


@dataclass(frozen=True)
class StoredFrame:
    """What the journal says of a frame's file.

    Parameters
    ----------
    bytes
        Size of the file.
    file_sha256, pixels_sha256
        Hashes of the file, and of the samples as 16-bit little-endian, row by row from the top,
        channels innermost.
    """

    bytes: int
    file_sha256: str
    pixels_sha256: str


def store_frame(path: Path, pixels: npt.NDArray[np.uint16]) -> StoredFrame:
    """Write a frame under a temporary name, flush it, and give it its name.

    The samples go to the disk from where they are: nothing is copied, and the interpreter's lock is
    free while the disk and the hashes work. Equal pixels give equal bytes.

    Parameters
    ----------
    path
        A name that is not taken.
    pixels
        ``(H, W)`` or ``(H, W, 3)`` uint16; contiguous, or they are copied once.

    Raises
    ------
    StorageError
        If the disk refuses; nothing stays under ``path`` then.
    """
    samples = np.ascontiguousarray(pixels, dtype="<u2").data.cast("B")
    header = tiff_header(pixels.shape, len(samples))
    part = part_path(path)
    of_file, of_pixels = hashlib.sha256(header), hashlib.sha256()
    try:
        with disk(path, "write"):
            descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
            try:
                _write(descriptor, memoryview(header))
                for start in range(0, len(samples), _PIECE):
                    piece = samples[start : start + _PIECE]
                    _write(descriptor, piece)
                    of_file.update(piece)
                    of_pixels.update(piece)
            finally:
                os.close(descriptor)
        publish(part, path)
    except BaseException:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise
    return StoredFrame(len(header) + len(samples), of_file.hexdigest(), of_pixels.hexdigest())


def tiff_header(shape: tuple[int, ...], size: int) -> bytes:
    """Return what stands before the samples of a TIFF 6.0 file with one strip, little-endian."""
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
        _ENTRY.pack(296, _SHORT, 1, 1, 0),  # pixels of no known size
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


def _write(descriptor: int, data: memoryview) -> None:
    while data:
        data = data[os.write(descriptor, data) :]
