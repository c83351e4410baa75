"""The header of a PLY file: its elements and their properties."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from rig import UnreadableError

# Enough for the comments and the few dozen properties that scanners write.
_MOST_BYTES: Final = 1 << 16
_ORDERS: Final = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES: Final = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip


@dataclass(frozen=True)
class Property:
    """A property: its name, the type of its values, and for a list the type of its count."""

    name: str
    kind: str
    count: str = ""


@dataclass(frozen=True)
class Element:
    """An element: its name, the number of its rows, and the properties of each row."""

    name: str
    count: int
    properties: tuple[Property, ...]

    @property
    def lists(self) -> tuple[Property, ...]:
        """Properties that are lists."""
        return tuple(one for one in self.properties if one.count)


def read_header(data: bytes) -> tuple[str, tuple[Element, ...], int]:
    """Return the byte order (empty for text), the elements, and the offset of the body.

    Raises
    ------
    UnreadableError
        If the data do not begin with a header of PLY 1.0; the message names the line.
    """
    end = re.search(rb"^end_header[ \t]*\r?(\n|$)", data[:_MOST_BYTES], re.MULTILINE)
    if data[:3] != b"ply" or end is None:
        raise UnreadableError("no PLY header from 'ply' to 'end_header': get a complete PLY file")
    order: str | None = None
    elements: list[tuple[str, int, list[Property]]] = []
    lines = data[: end.start()].decode("latin-1").splitlines()[1:]
    for number, line in enumerate(lines, 2):
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                continue
            case ["format", name, "1.0"] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", name, count] if re.fullmatch(r"[0-9]{1,10}", count):
                elements.append((name, int(count), []))
            case ["property", "list", count, kind, name] if (
                elements and kind in _TYPES and _TYPES.get(count, "f")[0] in "iu"
            ):
                elements[-1][2].append(Property(name, _TYPES[kind], _TYPES[count]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1][2].append(Property(name, _TYPES[kind]))
            case _:
                raise UnreadableError(f"line {number} of its header is damaged: {line[:60]!r}")
    if order is None:
        raise UnreadableError("its header has no line 'format ... 1.0'")
    complete = tuple(Element(name, count, tuple(of)) for name, count, of in elements)
    for element in complete:
        names = [one.name for one in element.properties]
        if len(set(names)) < len(names):
            raise UnreadableError(f"the element {element.name} has two properties of one name")
    return order, complete, end.end()
