"""A map in a file, of which rows are read and written."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError
from acquisition.files.storage import disk, open_binary, write_whole_at
from rig.arrays import AnyArray


class BandFile:
    """A map ``(H, ...)`` whose rows are in a file; usable by several threads.

    Rows that were never written are 0. Memory is used only by the rows that a caller holds.

    Parameters
    ----------
    path
        File of the raw values. An existing one is continued.
    shape
        ``(H, ...)``.
    dtype
        Type of the values, in the byte order of this computer.
    on_write
        Receives the first row, the row after the last, and the bytes, before they are written.

    Raises
    ------
    StorageError
        If the disk refuses the file, a read or a write.

    Examples
    --------
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from acquisition.files import BandFile
    >>> height = BandFile(Path("height.raw"), (100, 4), np.dtype(np.float32))
    >>> height[50:52] = np.ones((2, 4))
    >>> height[49:52].sum(axis=1)
    array([0., 4., 4.], dtype=float32)
    >>> height.close()
    """

    def __init__(
        self,
        path: Path,
        shape: tuple[int, ...],
        dtype: np.dtype[Any],
        on_write: Callable[[int, int, memoryview], object] = lambda first, last, data: None,
    ) -> None:
        self.path, self.shape, self.dtype = path, shape, dtype
        self._on_write = on_write
        self._row = math.prod(shape[1:]) * dtype.itemsize
        self._file = -1
        with disk(path, "create"):
            self._file = open_binary(path, os.O_RDWR | os.O_CREAT)
            if os.fstat(self._file).st_size != self.nbytes:
                os.ftruncate(self._file, self.nbytes)

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def size(self) -> int:
        """Number of values."""
        return math.prod(self.shape)

    @property
    def nbytes(self) -> int:
        """Number of bytes."""
        return self.shape[0] * self._row

    def __getitem__(self, rows: slice) -> AnyArray:
        first, count = self._range(rows)
        values = np.zeros((count, *self.shape[1:]), self.dtype)
        data = values.reshape(-1).view(np.uint8).data
        done = 0
        with disk(self.path, "read"):
            while done < len(data):
                read = os.preadv(self._file, [data[done:]], first * self._row + done)
                if not read:
                    raise DataError(f"{self.path}: was cut short while it was in use: start again")
                done += read
        return values

    def __setitem__(self, rows: slice, values: npt.ArrayLike) -> None:
        first, count = self._range(rows)
        whole = np.broadcast_to(np.asarray(values, self.dtype), (count, *self.shape[1:]))
        data = np.ascontiguousarray(whole).reshape(-1).view(np.uint8).data
        self._on_write(first, first + count, data)
        with disk(self.path, "write"):
            write_whole_at(self._file, data, first * self._row)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> AnyArray:
        return self[:].astype(dtype or self.dtype, copy=False)

    def _range(self, rows: slice) -> tuple[int, int]:
        first, last, step = rows.indices(self.shape[0])
        if step != 1:
            raise ValueError("rows are read and written one after the other")
        return first, max(last - first, 0)

    def sync(self) -> None:
        """Make what was written durable."""
        with disk(self.path, "write"):
            os.fsync(self._file)

    def close(self) -> None:
        """Close the file; harmless if repeated."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1
