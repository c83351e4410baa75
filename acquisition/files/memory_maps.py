"""Maps of a computation in memory, with the interface of those in files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from acquisition.files.map_rows import MapRows
from rig.arrays import AnyArray

Form = tuple[tuple[int, ...], type[np.generic]]


class MapToFill(MapRows, Protocol):
    """A map whose rows are read and written."""

    def __setitem__(self, rows: slice, values: npt.ArrayLike, /) -> None:
        """Replace rows."""


class Maps(Protocol):
    """The maps of a computation in steps, in memory (`MemoryMaps`) or in files (`BandStore`)."""

    def __getitem__(self, name: str, /) -> MapToFill:
        """Return a map."""

    def __contains__(self, name: object, /) -> bool:
        """Return whether there is a map of this name."""

    def missing(self, step: str, units: int) -> list[slice]:
        """Return the units of a step that are not complete, in order."""

    def complete(self, step: str, units: slice) -> None:
        """State that units of a step are complete; a map in files is durable then."""


class MemoryMap:
    """A map ``(H, ...)`` in memory; rows that were never written are 0.

    Rows that are read are those of the map itself and must not be changed. A new array of all rows
    is kept instead of copied.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition.files import MemoryMap
    >>> height = MemoryMap((100, 4), np.dtype(np.float32))
    >>> height[50:52] = np.ones((2, 4))
    >>> height[49:52].sum(axis=1)
    array([0., 4., 4.], dtype=float32)
    """

    def __init__(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self.shape, self.dtype = shape, dtype
        self._values: AnyArray | None = None
        self._is_shared = False  # with the caller, or with another map

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: slice) -> AnyArray:
        if self._values is None:
            self._values = np.zeros(self.shape, self.dtype)
        found = self._values[rows]
        self._is_shared |= len(found) == len(self)
        return found

    def __setitem__(self, rows: slice, values: npt.ArrayLike) -> None:
        given = np.asarray(values)
        if (given.shape, given.dtype) == (self.shape, self.dtype) and given.flags.c_contiguous:
            self._values, self._is_shared = given, True
            return
        if self._is_shared and self._values is not None:
            self._values, self._is_shared = self._values.copy(), False
        self[rows][:] = given

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> AnyArray:
        return np.array(self[:], dtype or self.dtype, copy=copy)


class MemoryMaps(Mapping[str, MemoryMap]):
    """The maps of a computation in memory; every step is computed once.

    Parameters
    ----------
    maps
        Shape ``(H, ...)`` and type of each map.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition.files import MemoryMaps
    >>> maps = MemoryMaps({"albedo": ((6, 4), np.float32)})
    >>> maps.missing("solve", 6), maps["albedo"][2:4].shape
    ([slice(0, 6, None)], (2, 4))
    """

    def __init__(self, maps: Mapping[str, Form]) -> None:
        self._maps = {
            name: MemoryMap(shape, np.dtype(kind)) for name, (shape, kind) in maps.items()
        }

    def __getitem__(self, name: str) -> MemoryMap:
        return self._maps[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._maps)

    def __len__(self) -> int:
        return len(self._maps)

    def missing(self, step: str, units: int) -> list[slice]:
        """Return all units of a step."""
        return [slice(0, units)]

    def complete(self, step: str, units: slice) -> None:
        """Do nothing: what is in memory is lost with the process."""
