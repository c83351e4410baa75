"""Strict reader of numeric arrays from .npy files.

Format: NumPy Enhancement Proposal 1. NumPy's own reader evaluates the header as Python and
allocates an array of the size that the header declares before it checks the size of the file.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from acquisition import DataError, MissingPathError
from rig import UnreadableError, read_bounded
from rig.arrays import AnyArray
from rig.files import MAX_BINARY_BYTES, read_head

_MAGIC: Final = b"\x93NUMPY"
_MOST_HEADER: Final = 10_000  # NumPy also rejects longer ones
_KEYS: Final = {
    "descr": re.compile(r"""['"]descr['"]\s*:\s*['"]([<>|=][a-zA-Z][0-9]{1,2})['"]"""),
    "order": re.compile(r"""['"]fortran_order['"]\s*:\s*(True|False)"""),
    "shape": re.compile(r"""['"]shape['"]\s*:\s*\(([0-9, L]{0,100})\)"""),
}


def read_npy(path: Path, max_numbers: int) -> AnyArray:
    """Read an array of numbers.

    Parameters
    ----------
    path
        The file.
    max_numbers
        Maximum number of elements.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If the file is not an array of integers or floats, is too large, or its size differs from
        the size that its header declares.
    """
    with readable(path, "array of numbers"):
        return _array(read_bounded(path, MAX_BINARY_BYTES), max_numbers)


def npy_shape(path: Path) -> tuple[int, ...]:
    """Return the shape that the header of a file states; raises as `read_npy`."""
    with readable(path, "array of numbers"):
        return _header(read_head(path, _MOST_HEADER)[0])[2]


@contextmanager
def readable(path: Path, what: str) -> Iterator[None]:
    """Turn errors of a bounded reader into those that readers of files declare, as `read_npy`."""
    try:
        yield
    except FileNotFoundError as error:
        raise MissingPathError(f"{path}: no such file") from error
    except UnreadableError as error:
        raise DataError(f"{path}: not a readable {what}: {error}") from error


def _header(data: bytes) -> tuple[np.dtype[Any], Literal["C", "F"], tuple[int, ...], int]:
    """Return type, order, shape and length of the header of a file."""
    version, width = data[6:7], 2 if data[6:7] == b"\x01" else 4
    if data[:6] != _MAGIC or version not in (b"\x01", b"\x02", b"\x03"):
        raise UnreadableError("the file does not begin with the header of a .npy file")
    begin = 8 + width
    end = begin + int.from_bytes(data[8:begin], "little")
    if not begin < end <= min(len(data), _MOST_HEADER):
        raise UnreadableError("the header is truncated or damaged")
    text = data[begin:end].decode("latin-1")
    matches = {name: pattern.search(text) for name, pattern in _KEYS.items()}
    descr, order, shape = (matches[name] for name in ("descr", "order", "shape"))
    if descr is None or order is None or shape is None:
        raise UnreadableError("the header is damaged, or the elements are not plain numbers")
    kind = descr[1]
    if kind[1] not in "iuf" or kind[2:] not in ("1", "2", "4", "8") or kind[1:] == "f1":
        name = {"c": "complex", "b": "bool", "O": "object"}.get(kind[1], kind)
        raise UnreadableError(f"elements of type {name}")
    sides = tuple(int(side) for side in re.findall(r"[0-9]+", shape[1][:60]))
    return np.dtype(kind), "F" if order[1] == "True" else "C", sides, end


def _array(data: bytes, max_numbers: int) -> AnyArray:
    dtype, order, sides, end = _header(data)
    count = math.prod(sides)
    if count > max_numbers:
        raise UnreadableError(f"{count} numbers, at most {max_numbers} are allowed")
    if len(data) - end != count * dtype.itemsize:
        raise UnreadableError(
            f"{len(data) - end} bytes for the shape {sides}: truncated or damaged"
        )
    values = np.frombuffer(data, dtype, count, end)
    return values.reshape(sides, order=order).copy()
