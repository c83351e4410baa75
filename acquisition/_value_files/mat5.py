"""Strict reader for one numeric array from a MAT-file of level 5.

Format: MathWorks, MAT-File Format (Level 5). Every length is checked against the enclosing data
before anything is read or unpacked, because one flipped bit can crash a reader that trusts lengths.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from rig import UnreadableError

_HEADER: Final = 128
_MATRIX, _COMPRESSED, _UTF8 = 14, 15, 16
# Numeric types of elements; MATLAB stores doubles with integer values in the smallest that fits.
_TYPES: Final = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
# Numeric array classes: mxDOUBLE to mxUINT64.
_NUMERIC: Final = range(6, 16)
_COMPLEX: Final = 0x0800


@dataclass(frozen=True)
class _Element:
    kind: int
    data: memoryview


def read_mat5(data: bytes, name: str, max_numbers: int) -> npt.NDArray[np.float64]:
    """Return a variable of a MAT-file as doubles.

    Parameters
    ----------
    data
        Content of the file.
    name
        Name of the variable.
    max_numbers
        Largest allowed number of elements.

    Returns
    -------
    npt.NDArray[np.float64]
        Array with the shape in the file.

    Raises
    ------
    UnreadableError
        If the file is not a MAT-file of level 5, is damaged, or has no numeric array of that name.
    """
    if data[:8] == b"\x89HDF\r\n\x1a\n" or data[:19] == b"MATLAB 7.3 MAT-file":
        raise UnreadableError("a MAT-file of version 7.3: save it in MATLAB with -v7")
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if len(data) < _HEADER or order is None:
        raise UnreadableError("not a MAT-file of version 5 to 7: save it in MATLAB with -v7")
    rest = memoryview(data)[_HEADER:]
    # Room for the numbers, and for a name and a shape.
    most_bytes = 8 * max_numbers + 4096
    while rest:
        element, rest = _next(rest, order)
        if element.kind == _COMPRESSED:
            element = _next(memoryview(_unpacked(element.data, most_bytes)), order)[0]
        if element.kind == _MATRIX:
            matrix = _matrix(element.data, order, name, max_numbers)
            if matrix is not None:
                return matrix
    raise UnreadableError(f"no variable {name}")


def mat5_names(data: bytes, most_bytes: int) -> list[str]:
    """Return the names of the variables of a MAT-file of level 5, also of those of other types.

    A variable of more bytes than ``most_bytes`` is left out.

    Raises
    ------
    UnreadableError
        If the file is damaged or of another kind.
    """
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None:
        raise UnreadableError("not a MAT-file of version 5 to 7: save it in MATLAB with -v7")
    names = []
    rest = memoryview(data)[_HEADER:]
    while rest:
        element, rest = _next(rest, order)
        try:
            if element.kind == _COMPRESSED:
                element = _next(memoryview(_unpacked(element.data, most_bytes)), order)[0]
            if element.kind != _MATRIX:
                continue
            _, content = _next(element.data, order)
            _, content = _next(content, order)
            name = bytes(_next(content, order)[0].data)
        except UnreadableError:
            continue
        if name.isascii() and name.decode().isidentifier():
            names.append(name.decode())
    return names


def _next(data: memoryview, order: str) -> tuple[_Element, memoryview]:
    """Return the first element and the data after it."""
    if len(data) < 8:
        raise UnreadableError("truncated in the header of an element")
    kind, size = struct.unpack(order + "II", data[:8])
    if kind >> 16:  # small element: type, length and up to four bytes of data
        kind, size = kind & 0xFFFF, kind >> 16
        if size > 4:
            raise UnreadableError("a small element of more than 4 bytes")
        return _Element(kind, data[4 : 4 + size]), data[8:]
    if size > len(data) - 8:
        raise UnreadableError(f"an element of {size} bytes, but only {len(data) - 8} are left")
    # Compressed elements are not padded.
    padding = 0 if kind == _COMPRESSED else -size % 8
    return _Element(kind, data[8 : 8 + size]), data[8 + size + padding :]


def _unpacked(packed: memoryview, most_bytes: int) -> bytes:
    unpacker = zlib.decompressobj()
    try:
        data = unpacker.decompress(packed, most_bytes + 1)
    except zlib.error as error:
        raise UnreadableError(f"its compressed data are damaged ({error})") from error
    if len(data) > most_bytes:
        raise UnreadableError("a variable with far more numbers than expected")
    if not unpacker.eof:
        raise UnreadableError("its compressed data are truncated")
    return data


def _matrix(
    data: memoryview, order: str, name: str, max_numbers: int
) -> npt.NDArray[np.float64] | None:
    """Return the numbers of a matrix; None if it has another name."""
    flags, data = _next(data, order)
    shape, data = _next(data, order)
    named, data = _next(data, order)
    if bytes(named.data) != name.encode("ascii"):
        return None
    if len(flags.data) != 8 or shape.kind != 5 or len(shape.data) % 4 or len(shape.data) < 8:
        raise UnreadableError(f"the header of {name} is damaged")
    (bits,) = struct.unpack(order + "I", flags.data[:4])
    if bits & 0xFF not in _NUMERIC or bits & _COMPLEX:
        raise UnreadableError(f"{name} is not an array of real numbers")
    sides = struct.unpack(f"{order}{len(shape.data) // 4}i", shape.data)
    if min(sides) < 1 or math.prod(sides) > max_numbers:
        raise UnreadableError(f"{name} has an unexpected shape {sides[:8]}")
    numbers, _ = _next(data, order)
    if numbers.kind not in _TYPES:
        raise UnreadableError(f"{name} is not an array of real numbers")
    stored = np.dtype(order + _TYPES[numbers.kind])
    if len(numbers.data) != math.prod(sides) * stored.itemsize:
        raise UnreadableError(
            f"{name} has {len(numbers.data)} bytes, which do not match its shape {sides[:8]}"
        )
    values = np.frombuffer(numbers.data, stored).astype(np.float64)
    return values.reshape(sides, order="F")
