"""A PLY file: its header, and its rows of numbers and lists, as text or binary."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from acquisition.mesh_files.mesh_file import numbers_of
from rig import UnreadableError, pluralize
from rig.arrays import AnyArray, Float64, Int64

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


@dataclass(frozen=True)
class Lists:
    """One list property of all rows: the lengths of the lists, and their concatenated values."""

    lengths: Int64
    values: AnyArray


@dataclass(frozen=True)
class Table:
    """The rows of an element: one column per scalar property, and one per list property."""

    columns: dict[str, Float64]
    lists: dict[str, Lists]


def read_body(data: memoryview, order: str, elements: tuple[Element, ...]) -> dict[str, Table]:
    """Return the rows of each element by the name of the element.

    Raises
    ------
    UnreadableError
        If there are fewer or more rows than the header states, a row has more numbers than it
        states, or a value is not a number.
    """
    if order:
        return dict(_binary(data, order, elements))
    text = bytes(data)
    try:
        tables = dict(_text(numbers_of(text), elements))
    except UnreadableError:
        _check_rows(text, elements)  # it can say more
        raise
    counts = [len(line.split()) for line in text.splitlines() if line.strip()]
    widths = np.concatenate([_widths(one, tables) for one in elements] or [np.zeros(0, np.int64)])
    if len(counts) != len(widths) or counts != widths.tolist():
        _check_rows(text, elements)
    if sum(counts) > widths.sum():
        raise UnreadableError(
            f"it has {sum(counts)} numbers, its header states {widths.sum()}: correct the header"
        )
    return tables


def _widths(element: Element, tables: dict[str, Table]) -> Int64:
    """Return how many numbers each row of an element has."""
    if not element.properties:
        return np.zeros(0, np.int64)
    lists = tables[element.name].lists.values()
    each = np.full(element.count, len(element.properties), np.int64)
    return each + sum(one.lengths for one in lists)


def _check_rows(text: bytes, elements: tuple[Element, ...]) -> None:
    """Raise an UnreadableError that names the first row that the header does not describe."""
    lines = [line for line in text.splitlines() if line.strip()]
    rows = sum(element.count for element in elements if element.properties)
    if len(lines) < rows:
        return  # truncated, or not one row per line
    for element in elements:
        for row, line in enumerate(lines[: element.count if element.properties else 0], 1):
            words = line.split()
            width = 0
            for one in element.properties:
                listed = words[width : width + 1] if one.count else []
                width += 1 + sum(int(word) for word in listed if word.isdigit() and len(word) < 9)
            if len(words) != width:
                raise UnreadableError(
                    f"row {row} of its {element.name} elements has "
                    f"{pluralize(len(words), 'number')}, its header states {width}: correct the "
                    "header, or the rows"
                )
        del lines[: element.count if element.properties else 0]
    if lines:
        raise UnreadableError(
            f"it has {pluralize(len(lines), 'row')} more than the {rows} of its header: correct "
            "the header"
        )


def _text(numbers: Float64, elements: tuple[Element, ...]) -> Iterator[tuple[str, Table]]:
    at = 0
    for element in elements:
        _check_room(element, element.count * len(element.properties), len(numbers) - at)
        if not element.properties:
            continue
        sizes = _row_sizes_alike(element, numbers[at:])
        if sizes is not None:
            width = sum(sizes)
            rows = numbers[at : at + element.count * width].reshape(element.count, width)
            yield element.name, _of_rows(element, rows, sizes)
            at += element.count * width
        else:
            table, at = _chased(element, numbers, at)
            yield element.name, table


def _row_sizes_alike(element: Element, numbers: Float64) -> list[int] | None:
    """Return the count of numbers per property if it is the same in all rows, else None."""
    sizes = []
    at = 0
    for one in element.properties:
        length = _length(numbers, at) if one.count and element.count else 0
        sizes.append(1 + length)
        at += 1 + length
    if at * element.count > len(numbers):
        return None
    rows = numbers[: at * element.count].reshape(element.count, at)
    begin = 0
    for one, size in zip(element.properties, sizes, strict=True):
        if one.count and not (rows[:, begin] == size - 1).all():
            return None
        begin += size
    return sizes


def _of_rows(element: Element, rows: Float64, sizes: list[int]) -> Table:
    columns: dict[str, Float64] = {}
    lists: dict[str, Lists] = {}
    begin = 0
    for one, size in zip(element.properties, sizes, strict=True):
        if one.count:
            lengths = np.full(len(rows), size - 1, np.int64)
            lists[one.name] = Lists(lengths, rows[:, begin + 1 : begin + size].ravel())
        else:
            columns[one.name] = rows[:, begin]
        begin += size
    return Table(columns, lists)


def _chased(element: Element, numbers: Float64, at: int) -> tuple[Table, int]:
    """Read rows of different lengths, one after another."""
    places: dict[str, list[int]] = {one.name: [] for one in element.properties}
    lengths: dict[str, list[int]] = {one.name: [] for one in element.lists}
    for _ in range(element.count):
        for one in element.properties:
            places[one.name].append(at)
            if one.count:
                length = _length(numbers, at)
                lengths[one.name].append(length)
                at += length
            at += 1
    if at > len(numbers):
        raise _truncated(element)
    lists = {}
    for name, counts in lengths.items():
        begins = np.array(places.pop(name), np.int64) + 1
        picked = numbers[_ranges(begins, np.array(counts, np.int64))]
        lists[name] = Lists(np.array(counts, np.int64), picked)
    return Table({name: numbers[where] for name, where in places.items()}, lists), at


def _length(numbers: Float64, at: int) -> int:
    """Return the length of the list that begins at ``at``."""
    if at >= len(numbers):
        raise UnreadableError("truncated: it ends within a list: get the complete file")
    length = numbers[at]
    if not (0 <= length <= len(numbers) and length == int(length)):
        raise UnreadableError(f"a list of {length:g} numbers: the file is damaged")
    return int(length)


def _binary(
    data: memoryview, order: str, elements: tuple[Element, ...]
) -> Iterator[tuple[str, Table]]:
    for element in elements:
        least = sum(np.dtype(one.count or one.kind).itemsize for one in element.properties)
        _check_room(element, element.count * least, len(data))
        if not element.properties:
            continue
        rows, data = _rows_alike(data, order, element)
        if rows is not None:
            yield element.name, _of_records(element, rows)
        else:
            table, data = _chased_bytes(data, order, element)
            yield element.name, table
    # Some programs end a file with a line break, and some fill it up to a round size.
    if more := len(bytes(data).strip(b"\0\r\n\t ")):
        raise UnreadableError(
            f"it has about {more} bytes more than its header states: correct the header"
        )


def _rows_alike(
    data: memoryview, order: str, element: Element
) -> tuple[AnyArray | None, memoryview]:
    """Read rows if all their lists have the lengths of the first row, else return None."""
    fields: list[Any] = []
    at = 0
    for one in element.properties:
        kind = np.dtype(order + one.kind)
        if one.count and element.count:
            count = np.dtype(order + one.count)
            length = _length_at(data, at, _reader(count))
            fields += [(f"#{one.name}", count), (one.name, kind, (length,))]
            at += count.itemsize + length * kind.itemsize
        else:
            fields.append((one.name, kind))
            at += kind.itemsize
        if at > len(data) and element.count:
            raise _truncated(element)
    row = np.dtype(fields)
    if row.itemsize * element.count > len(data):
        return None, data
    rows = np.frombuffer(data, row, element.count)
    for one in element.lists if element.count else ():
        if not (rows[f"#{one.name}"] == rows[one.name].shape[1]).all():
            return None, data
    return rows, data[row.itemsize * element.count :]


def _of_records(element: Element, rows: AnyArray) -> Table:
    columns: dict[str, Float64] = {}
    lists: dict[str, Lists] = {}
    for one in element.properties:
        if one.count:
            values = rows[one.name].reshape(len(rows), -1) if len(rows) else np.zeros((0, 0))
            lengths = np.full(len(rows), values.shape[1], np.int64)
            lists[one.name] = Lists(lengths, values.ravel())
        else:
            columns[one.name] = _as_double(rows[one.name])
    return Table(columns, lists)


def _as_double(values: AnyArray) -> Float64:
    with np.errstate(invalid="ignore"):  # a signalling NaN becomes a quiet one
        return values.astype(np.float64)


def _chased_bytes(data: memoryview, order: str, element: Element) -> tuple[Table, memoryview]:
    """Read rows of different lengths, one after another."""
    kinds = {one.name: np.dtype(order + one.kind) for one in element.properties}
    places: dict[str, list[int]] = {one.name: [] for one in element.properties}
    lengths: dict[str, list[int]] = {one.name: [] for one in element.lists}
    steps = [
        (
            one.name,
            kinds[one.name].itemsize,
            _reader(np.dtype(order + one.count)) if one.count else None,
        )
        for one in element.properties
    ]
    at = 0
    for _ in range(element.count):
        for name, size, count in steps:
            if count is not None:
                length = _length_at(data, at, count)
                at += count.size
                lengths[name].append(length)
                places[name].append(at)
                at += size * length
            else:
                places[name].append(at)
                at += size
    if at > len(data):
        raise _truncated(element)
    content = np.frombuffer(data, np.uint8)

    def values(name: str, counts: Int64) -> AnyArray:
        size = kinds[name].itemsize
        picked = content[_ranges(np.array(places[name], np.int64), counts * size)]
        return picked.view(kinds[name])

    lists = {
        name: Lists(np.array(counts, np.int64), values(name, np.array(counts, np.int64)))
        for name, counts in lengths.items()
    }
    once = np.ones(element.count, np.int64)
    columns = {
        one.name: _as_double(values(one.name, once)) for one in element.properties if not one.count
    }
    return Table(columns, lists), data[at:]


def _reader(kind: np.dtype[Any]) -> struct.Struct:
    """Return a struct that reads one number of a type, which is faster than NumPy."""
    return struct.Struct((">" if kind.str[0] == ">" else "<") + kind.char)


def _length_at(data: memoryview, at: int, reader: struct.Struct) -> int:
    """Return the length of the list that begins at ``at``."""
    if at + reader.size > len(data):
        raise UnreadableError("truncated: it ends within a list: get the complete file")
    (length,) = reader.unpack_from(data, at)
    if not 0 <= length <= len(data):
        raise UnreadableError(f"a list of {length} numbers: the file is damaged or truncated")
    return int(length)


def _ranges(begins: Int64, lengths: Int64) -> Int64:
    """Return the concatenated index ranges ``begin, begin + 1, ...`` of the given lengths."""
    ends = np.cumsum(lengths)
    total = int(ends[-1]) if len(ends) else 0
    return np.asarray(np.arange(total) + np.repeat(begins - (ends - lengths), lengths), np.int64)


def _check_room(element: Element, needed: int, available: int) -> None:
    if needed > available:
        raise _truncated(element)


def _truncated(element: Element) -> UnreadableError:
    return UnreadableError(
        f"truncated: it has fewer than the {element.count} {element.name} elements of its header: "
        "get the complete file"
    )
