"""A map of which only some rows are in memory at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeGuard

import numpy as np

from rig.arrays import AnyArray


class MapRows(Protocol):
    """What an array, a `BandFile` and `ComputedRows` have in common: rows by a slice."""

    @property
    def shape(self) -> tuple[int, ...]:
        """``(H, ...)`` of the complete map."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the values."""

    def __getitem__(self, rows: slice, /) -> AnyArray:
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
    >>> from acquisition import read_image, write_exr
    >>> from acquisition.files import ComputedRows
    >>> column = np.arange(6, dtype=np.float32)[:, None]
    >>> double = ComputedRows((6, 1), column.dtype, lambda rows: 2 * column[rows])
    >>> write_exr("double.exr", double)
    >>> read_image("double.exr")[:, 0]
    array([ 0.,  2.,  4.,  6.,  8., 10.], dtype=float32)
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    compute: Callable[[slice], AnyArray]

    def __getitem__(self, rows: slice) -> AnyArray:
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
    >>> from acquisition.files import rows_in_bands
    >>> rows_in_bands(10, row_bytes=400, band_bytes=1700)
    [slice(0, 4, None), slice(4, 8, None), slice(8, 10, None)]
    """
    step = max(least, band_bytes // max(row_bytes, 1), 1)
    return [slice(top, min(top + step, height)) for top in range(0, height, step)]
