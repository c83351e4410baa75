"""Accessors of a GLB file as arrays: strides, normalised integers and sparse values.

Format: Khronos, glTF 2.0, section 3.6.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Final

import numpy as np

from rig import UnreadableError
from rig.arrays import AnyArray

_KINDS: Final = {
    5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"
}  # fmt: skip
_NUMBERS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
# Extensions of buffer views and primitives that hold data in a form of their own.
_CODED: Final = ("compression", "draco")


class Accessors:
    """The arrays of a GLB file; lengths are checked before anything is read.

    Parameters
    ----------
    content
        The JSON.
    data
        The binary chunk.
    """

    def __init__(self, content: dict[str, Any], data: memoryview) -> None:
        self._views = content.get("bufferViews", [])
        self._all = content.get("accessors", [])
        self._data = data
        self._table = lru_cache(maxsize=256)(self._read)
        buffers = content.get("buffers", [])
        if len(buffers) > 1 or any("uri" in one for one in buffers):
            raise UnreadableError("its data are in another file: save everything in one GLB file")
        for view in self._views:
            refuse_coded(view)
            begin, length = as_count(view.get("byteOffset", 0)), as_count(view["byteLength"])
            if as_count(view.get("buffer", 0)) or begin + length > len(data):
                raise UnreadableError(
                    "truncated: its lengths go beyond its end: get the complete file"
                )

    def count(self, place: Any) -> int:
        """Return the number of elements of an accessor."""
        return as_count(self._all[as_count(place)]["count"])

    def table(self, place: Any, form: str) -> AnyArray:
        """Return an accessor as ``(count, numbers)``; normalised integers become float64."""
        found = self._table(as_count(place))
        if self._all[place]["type"] != form:
            raise UnreadableError(f"an accessor of type {self._all[place]['type']}, not {form}")
        return found

    def _read(self, place: int) -> AnyArray:
        one = self._all[place]
        count, numbers = as_count(one["count"]), _NUMBERS[one["type"]]
        kind = np.dtype(_KINDS[one["componentType"]])
        if "bufferView" in one:
            values = self._rows(one, kind, count, numbers)
        else:
            # Zeros without data must not take more memory than the file itself.
            if count > len(self._data):
                raise UnreadableError("its counts go beyond its data: get the complete file")
            values = np.zeros((count, numbers), kind)
        if "sparse" in one:
            changed = one["sparse"]
            few = as_count(changed["count"])
            index = np.dtype(_KINDS[changed["indices"]["componentType"]])
            rows = self._rows(changed["indices"], index, few, 1)[:, 0]
            if index.kind != "u" or (few and rows.max() >= count):
                raise UnreadableError("sparse values of elements that do not exist")
            values = values.copy()
            values[rows] = self._rows(changed["values"], kind, few, numbers)
        if one.get("normalized", False) and kind.kind in "iu":
            most = np.iinfo(kind).max
            return np.maximum(values.astype(np.float64) / most, -1.0)
        return values

    def _rows(self, one: dict[str, Any], kind: np.dtype[Any], count: int, numbers: int) -> AnyArray:
        view = self._views[as_count(one["bufferView"])]
        size = kind.itemsize * numbers
        step = as_count(view.get("byteStride", size)) or size
        begin = as_count(one.get("byteOffset", 0))
        needed = begin + step * (count - 1) + size if count else 0
        if step < size or needed > view["byteLength"]:
            raise UnreadableError("truncated: its counts go beyond its data: get the complete file")
        begin += as_count(view.get("byteOffset", 0))
        return np.ndarray((count, numbers), kind, self._data, begin, (step, kind.itemsize))


def as_count(value: Any) -> int:
    """Return a value that must be a count; raise an UnreadableError if it is not."""
    if type(value) is not int or value < 0:
        raise UnreadableError(f"{str(value)[:40]!r} instead of a count: the file is damaged")
    return value


def refuse_coded(one: dict[str, Any]) -> None:
    """Refuse data that an extension holds in a form of its own; the message names it."""
    for name in one.get("extensions", ()):
        if any(word in name for word in _CODED):
            raise UnreadableError(f"the extension {name[:60]} is not supported: save it without it")
