"""Rows of an uncompressed TIFF file that was checked before."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError
from acquisition._part_files import BINARY, NO_WAIT
from acquisition._pixels.plain_tiff import plain_tiff_header
from rig import note_read

_PIECE = 1 << 20
_SAMPLE = np.dtype("<u2")


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

    def read(self, first: int, last: int) -> npt.NDArray[np.uint16]:
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
