"""Rows of the frames of a source, each of which is checked and decoded once."""

from __future__ import annotations

import math
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Self

import numpy as np

from acquisition._pixels.images import Image
from acquisition._pixels.plain_rows import PlainRows
from acquisition._source.source import Frame
from acquisition._storage import storage_error


@dataclass(frozen=True)
class _Kept:
    """Place and type of the samples of a frame in the temporary file."""

    begin: int
    dtype: np.dtype[np.generic]


class RowReader:
    """Reads rows of frames; may be used by several threads.

    The first access to a frame checks the file. The rows of an uncompressed frame of a session are
    then read from its file. Any other file is decoded, and its samples are kept in a temporary file
    without a name until `close`.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import RowReader, read_source, write_png
    >>> write_png("card.png", np.arange(20, dtype=np.uint16).reshape(4, 5))
    >>> with RowReader() as reader:
    ...     reader.rows(read_source("card.png").frames[0], 1, 2)
    array([[5, 6, 7, 8, 9]], dtype=uint16)
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._of_frame: dict[Frame, PlainRows | _Kept] = {}
        self._file: BinaryIO | None = None
        self._end = 0

    def check(self, frame: Frame) -> None:
        """Check the file of a frame, and prepare its rows; later calls do nothing.

        Raises
        ------
        DataError
            As `Frame.read`, or if samples are not finite.
        StorageError
            If the temporary file cannot be written.
        """
        self._rows_of(frame)

    def rows(self, frame: Frame, first: int, last: int) -> Image:
        """Return the rows from ``first`` to before ``last`` as stored; raises as `check`."""
        kept = self._rows_of(frame)
        if isinstance(kept, PlainRows):
            return kept.read(first, last)
        size = kept.dtype.itemsize * math.prod(frame.shape[1:])
        with self._lock:
            if self._file is None:
                raise ValueError("the reader is closed")
            self._file.seek(kept.begin + first * size)
            data = self._file.read((last - first) * size)
        rows: Image = np.frombuffer(data, kept.dtype).reshape(last - first, *frame.shape[1:])
        return rows

    def _rows_of(self, frame: Frame) -> PlainRows | _Kept:
        with self._lock:
            known = self._of_frame.get(frame)
        if known is not None:
            return known
        rows = None if frame.check_rows is None else frame.check_rows()
        found = self._keep(frame) if rows is None else rows
        with self._lock:
            return self._of_frame.setdefault(frame, found)

    def _keep(self, frame: Frame) -> _Kept:
        pixels = frame.read_finite()
        with self._lock:
            begin, self._end = self._end, self._end + pixels.nbytes
            try:
                if self._file is None:
                    self._file = tempfile.TemporaryFile(prefix="sgp-")  # noqa: SIM115 - see close
                self._file.seek(begin)
                self._file.write(np.ascontiguousarray(pixels).reshape(-1).view(np.uint8).data)
                self._file.flush()
            except OSError as error:
                folder = Path(tempfile.gettempdir())
                raise storage_error(folder, "keep decoded frames", error) from error
        return _Kept(begin, pixels.dtype)

    def close(self) -> None:
        """Remove the temporary file."""
        with self._lock:
            if self._file is not None:
                self._file.close()
            self._file = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
