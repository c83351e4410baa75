"""Maps of which only some rows are in memory at a time: computed ones, and those in a file."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeGuard

import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError
from acquisition._storage import disk, open_binary, write_whole_at

Rows = npt.NDArray[Any]


class MapRows(Protocol):
    """What an array, a `BandFile` and `ComputedRows` have in common: rows by a slice."""

    @property
    def shape(self) -> tuple[int, ...]:
        """``(H, ...)`` of the complete map."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the values."""

    def __getitem__(self, rows: slice, /) -> Rows:
        """Return the rows from ``rows.start`` to before ``rows.stop``."""


@dataclass(frozen=True, eq=False)
class ComputedRows:
    """A map whose rows are computed whenever they are read.

    Parameters
    ----------
    shape
        ``(H, ...)`` of the complete map.
    dtype
        Type of the values.
    compute
        Function of a slice with start and stop that returns these rows.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import ComputedRows, read_image, write_exr
    >>> column = np.arange(6, dtype=np.float32)[:, None]
    >>> double = ComputedRows((6, 1), column.dtype, lambda rows: 2 * column[rows])
    >>> write_exr("double.exr", double)
    >>> read_image("double.exr")[:, 0]
    array([ 0.,  2.,  4.,  6.,  8., 10.], dtype=float32)
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    compute: Callable[[slice], Rows]

    def __getitem__(self, rows: slice) -> Rows:
        first, last, _ = rows.indices(self.shape[0])
        return self.compute(slice(first, last))


def rows_of(values: object) -> MapRows:
    """Return a map as it is, and anything else as an array."""
    return values if _is_map(values) else np.asarray(values)


def _is_map(values: object) -> TypeGuard[MapRows]:
    return all(hasattr(values, name) for name in ("shape", "dtype", "__getitem__"))


def rows_in_bands(height: int, row_bytes: int, band_bytes: int, *, least: int = 1) -> list[slice]:
    """Return consecutive rows that need at most a number of bytes each.

    Parameters
    ----------
    height
        Rows in all.
    row_bytes
        Bytes that a row needs while it is in use, with everything that is computed of it.
    band_bytes
        Bytes of a band.
    least
        Rows of a band even if they need more.

    Examples
    --------
    >>> from acquisition import rows_in_bands
    >>> rows_in_bands(10, row_bytes=400, band_bytes=1700)
    [slice(0, 4, None), slice(4, 8, None), slice(8, 10, None)]
    """
    step = max(least, band_bytes // max(row_bytes, 1), 1)
    return [slice(top, min(top + step, height)) for top in range(0, height, step)]


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

    Raises
    ------
    StorageError
        If the disk refuses the file, a read or a write.

    Examples
    --------
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from acquisition import BandFile
    >>> height = BandFile(Path("height.raw"), (100, 4), np.dtype(np.float32))
    >>> height[50:52] = np.ones((2, 4))
    >>> height[49:52].sum(axis=1)
    array([0., 4., 4.], dtype=float32)
    >>> height.close()
    """

    def __init__(self, path: Path, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self.path, self.shape, self.dtype = path, shape, dtype
        self._row = math.prod(shape[1:]) * dtype.itemsize
        size = shape[0] * self._row
        self._file = -1
        with disk(path, "create"):
            self._file = open_binary(path, os.O_RDWR | os.O_CREAT)
            if os.fstat(self._file).st_size != size:
                os.ftruncate(self._file, size)

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def size(self) -> int:
        """Number of values."""
        return math.prod(self.shape)

    def __getitem__(self, rows: slice) -> Rows:
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
        with disk(self.path, "write"):
            write_whole_at(self._file, data, first * self._row)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Rows:
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
