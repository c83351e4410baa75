"""Uncompressed TIFF files: a header, followed by the samples as they are in memory."""

from __future__ import annotations

import os
import stat
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np

from acquisition._errors import DataError
from acquisition.files.part_files import BINARY, NO_WAIT
from rig.arrays import UInt16
from rig.files import note_read

_SHORT, _LONG, _RATIONAL = 3, 4, 5
_HEADER: Final = struct.Struct("<2sHI")
# Tag, type, count, and the values or their place; a short value is in the first two bytes.
_ENTRY: Final = struct.Struct("<HHII")
_PIECE = 1 << 20
_SAMPLE = np.dtype("<u2")


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
    entries = (
        (256, _LONG, 1, width),
        (257, _LONG, 1, height),
        (258, _SHORT, 3, depths_at) if channels == 3 else (258, _SHORT, 1, 16),
        (259, _SHORT, 1, 1),  # not compressed
        (262, _SHORT, 1, 1 if channels == 1 else 2),  # black is zero, or RGB
        (273, _LONG, 1, scale_at + 8),
        (274, _SHORT, 1, 1),  # rows from the top
        (277, _SHORT, 1, channels),
        (278, _LONG, 1, height),
        (279, _LONG, 1, size),
        (282, _RATIONAL, 1, scale_at),
        (283, _RATIONAL, 1, scale_at),
        (284, _SHORT, 1, 1),  # channels innermost
        (296, _SHORT, 1, 1),  # pixel size not known
    )
    directory = b"".join(_ENTRY.pack(*entry) for entry in entries)
    head = _HEADER.pack(b"II", 42, _HEADER.size) + struct.pack("<H", count)
    return head + directory + struct.pack("<I4H2I", 0, 16, 16, 16, 0, 1, 1)


@dataclass(frozen=True)
class PlainRows:
    """Place of the samples in a file, and what the file was when it was checked.

    Parameters
    ----------
    path
        The file.
    shape
        ``(H, W)`` or ``(H, W, 3)`` of its uint16 samples.
    begin
        Bytes before the first sample.
    stamp
        Device, inode, size and time of the last change.
    """

    path: Path
    shape: tuple[int, ...]
    begin: int
    stamp: tuple[int, int, int, int]

    def read(self, first: int, last: int) -> UInt16:
        """Return the rows from ``first`` to before ``last``.

        Raises
        ------
        DataError
            If the file is gone, cannot be read, or is not the one that was checked.
        """
        size = _SAMPLE.itemsize * int(np.prod(self.shape[1:]))
        try:
            with _opened(self.path) as file:
                same = _stamp(file) == self.stamp
                file.seek(self.begin + first * size)
                data = file.read((last - first) * size)
        except OSError as error:
            raise DataError(
                f"{self.path}: could be read before and now cannot: check the disk"
            ) from error
        if not same:
            raise DataError(f"{self.path}: was changed while it was in use: start again")
        rows = np.frombuffer(data, _SAMPLE).reshape(last - first, *self.shape[1:])
        return rows.astype(np.uint16, copy=False)


def plain_rows(
    path: Path, shape: tuple[int, ...], on_piece: Callable[[bytes], object]
) -> PlainRows | None:
    """Read the samples of a file that has the form that `plain_tiff_header` describes.

    Parameters
    ----------
    path
        The file.
    shape
        ``(H, W)`` or ``(H, W, 3)`` that it should have.
    on_piece
        Receives all samples, piece by piece, for a hash.

    Returns
    -------
    PlainRows | None
        Where the rows are; None if the file has another form or cannot be read.
    """
    size = _SAMPLE.itemsize * int(np.prod(shape))
    header = plain_tiff_header(shape, size)
    try:
        with _opened(path) as file:
            stamp, status = _stamp(file), note_read(path, file.fileno())
            plain = stat.S_ISREG(status.st_mode) and status.st_size == len(header) + size
            if not plain or file.read(len(header)) != header:
                return None
            while piece := file.read(_PIECE):
                on_piece(piece)
    except OSError:
        return None
    return PlainRows(path, shape, len(header), stamp)


def _opened(path: Path) -> BinaryIO:
    # Opening a pipe would wait for its writer.
    return os.fdopen(os.open(path, os.O_RDONLY | BINARY | NO_WAIT), "rb")


def _stamp(file: BinaryIO) -> tuple[int, int, int, int]:
    status = os.fstat(file.fileno())
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns
