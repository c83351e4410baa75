"""MAT-files of level 5: a strict reader for numeric arrays, and a writer for true normals.

Format: MathWorks, MAT-File Format (Level 5). Every length is checked against the enclosing data
before anything is read or unpacked, because one flipped bit can crash a reader that trusts lengths.
"""

from __future__ import annotations

import io
import math
import struct
import zlib
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from acquisition._errors import DataError, convert_read_errors
from acquisition.files.storage import write_durably
from rig import UnreadableError, read_bounded
from rig.arrays import Float32, Float64
from rig.files import MAX_BINARY_BYTES

_HEADER: Final = 128
_MATRIX, _COMPRESSED = 14, 15
# Numeric types of elements; MATLAB stores doubles with integer values in the smallest that fits.
_TYPES: Final = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
# Numeric array classes: mxDOUBLE to mxUINT64.
_NUMERIC: Final = range(6, 16)
_COMPLEX: Final = 0x0800
# The first 116 bytes are free text, to which SciPy writes the time and the system.
_TEXT: Final = b"MATLAB 5.0 MAT-file".ljust(116)
_MOST_NUMBERS: Final = 300_000


@dataclass(frozen=True)
class _Element:
    kind: int
    data: memoryview


def read_mat5(data: bytes, name: str, max_numbers: int) -> Float64:
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
    found = _variable(data, name, max_numbers)
    if found is None:
        raise UnreadableError(f"no variable {name}")
    return found


def _variable(data: bytes, name: str, max_numbers: int) -> Float64 | None:
    """Return a variable as `read_mat5` does, or None if no variable has this name."""
    if data[:8] == b"\x89HDF\r\n\x1a\n" or data[:19] == b"MATLAB 7.3 MAT-file":
        raise UnreadableError("a MAT-file of version 7.3: save it in MATLAB with -v7")
    for element, order in _elements(data):
        whole = _unpacked(element, _most_bytes(max_numbers), order)
        matrix = _matrix(whole.data, order, name, max_numbers) if whole.kind == _MATRIX else None
        if matrix is not None:
            return matrix
    return None


def _most_bytes(max_numbers: int) -> int:
    # Room for the numbers, and for a name and a shape.
    return 8 * max_numbers + 4096


def _elements(data: bytes) -> Iterator[tuple[_Element, str]]:
    """Yield the elements of a file as they are stored, each with the byte order of the header."""
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None:
        raise UnreadableError("not a MAT-file of version 5 to 7: save it in MATLAB with -v7")
    rest = memoryview(data)[_HEADER:]
    while rest:
        element, rest = _next(rest, order)
        yield element, order


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


def _unpacked(element: _Element, most_bytes: int, order: str) -> _Element:
    """Return the element in a compressed one; others are returned as they are."""
    if element.kind != _COMPRESSED:
        return element
    unpacker = zlib.decompressobj()
    try:
        data = unpacker.decompress(element.data, most_bytes + 1)
    except zlib.error as error:
        raise UnreadableError(f"its compressed data are damaged ({error})") from error
    if len(data) > most_bytes:
        raise UnreadableError("a variable with far more numbers than expected")
    if not unpacker.eof:
        raise UnreadableError("its compressed data are truncated")
    return _next(memoryview(data), order)[0]


def _matrix(data: memoryview, order: str, name: str, max_numbers: int) -> Float64 | None:
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


def write_normals_mat(path: Path, normals: Float32) -> None:
    """Write normals ``(H, W, 3)`` as ``Normal_gt``; equal normals give equal bytes.

    Raises
    ------
    StorageError
        If the file cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from acquisition.value_files import write_normals_mat
    >>> write_normals_mat(Path("Normal_gt.mat"), np.tile(np.float32([0, 0, 1]), (4, 5, 1)))
    """
    # SciPy's writers take as long to import as the rest of this package.
    from scipy.io import savemat

    file: Any = io.BytesIO()  # SciPy's annotations allow only file names
    savemat(file, {"Normal_gt": normals.astype(np.float64)}, do_compression=True)
    write_durably(path, _TEXT, file.getbuffer()[len(_TEXT) :])


def variable_names(path: Path) -> list[str]:
    """Return the names of all variables of a MAT-file, numeric or not; errors as below.

    Damaged variables, and those with far more numbers than expected, are left out.
    """
    names = []
    with convert_read_errors(path):
        for stored, order in _elements(read_bounded(path, MAX_BINARY_BYTES)):
            with suppress(UnreadableError):
                element = _unpacked(stored, _most_bytes(_MOST_NUMBERS), order)
                _, content = _next(element.data, order)
                _, content = _next(content, order)
                name = bytes(_next(content, order)[0].data)
                if element.kind == _MATRIX and name.isascii() and name.decode().isidentifier():
                    names.append(name.decode())
    return names


def read_variables(path: Path, names: Iterable[str]) -> dict[str, Float64]:
    """Return those of the named numeric variables that a MAT-file has.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If the file is not a MAT-file of level 5, or is damaged.
    """
    with convert_read_errors(path):
        data = read_bounded(path, MAX_BINARY_BYTES)
        variables = {name: _variable(data, name, _MOST_NUMBERS) for name in names}
    found = {name: values for name, values in variables.items() if values is not None}
    for name, values in found.items():
        if values.ndim != 2:
            raise DataError(f"{path}: {name} is not a matrix, but has the shape {values.shape}")
    return found
