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
        return dict(_Body(data, order).tables(elements))
    text = bytes(data)
    try:
        tables = dict(_Body(numbers_of(text).view(np.uint8).data, "").tables(elements))
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


@dataclass(frozen=True)
class _Body:
    """The rows of all elements as bytes; the numbers of a text are doubles, without an order."""

    data: memoryview
    order: str

    def tables(self, elements: tuple[Element, ...]) -> Iterator[tuple[str, Table]]:
        """Yield the rows of each element."""
        at = 0
        for element in elements:
            least = sum(self._type(one.count or one.kind).itemsize for one in element.properties)
            if at + element.count * least > len(self.data):
                raise _truncated(element)
            if not element.properties:
                continue
            rows = self._rows_alike(element, at)
            if rows is not None:
                yield element.name, _of_records(element, rows)
                at += rows.nbytes
            else:
                table, at = self._chased(element, at)
                yield element.name, table
        # Some programs end a file with a line break, and some fill it up to a round size.
        if self.order and (more := len(bytes(self.data[at:]).strip(b"\0\r\n\t "))):
            raise UnreadableError(
                f"it has about {more} bytes more than its header states: correct the header"
            )

    def _type(self, kind: str) -> np.dtype[Any]:
        return np.dtype(self.order + kind if self.order else "f8")

    def _rows_alike(self, element: Element, begin: int) -> AnyArray | None:
        """Read rows if all their lists have the lengths of the first row, else return None."""
        fields: list[Any] = []
        at = begin
        for one in element.properties:
            kind = self._type(one.kind)
            if one.count:
                count = self._type(one.count)
                length = self._length_at(at, _reader(count), begin) if element.count else 0
                fields += [(_count_of(one), count), (one.name, kind, (length,))]
                at += count.itemsize + length * kind.itemsize
            else:
                fields.append((one.name, kind))
                at += kind.itemsize
            if self.order and at > len(self.data) and element.count:
                raise _truncated(element)
        row = np.dtype(fields)
        if row.itemsize * element.count > len(self.data) - begin:
            return None
        rows = np.frombuffer(self.data, row, element.count, begin)
        alike = (rows[_count_of(one)] == rows[one.name].shape[1] for one in element.lists)
        return rows if all(each.all() for each in alike) else None

    def _chased(self, element: Element, begin: int) -> tuple[Table, int]:
        """Read rows of different lengths, one after another; return the place after them, too."""
        kinds = {one.name: self._type(one.kind) for one in element.properties}
        readers = {one.name: _reader(self._type(one.count)) for one in element.lists}
        places: dict[str, list[int]] = {name: [] for name in kinds}
        lengths: dict[str, list[int]] = {name: [] for name in readers}
        steps = [(name, kind.itemsize, readers.get(name)) for name, kind in kinds.items()]
        at = begin
        # In a text, only the lists of the first row are compared with the numbers that are left.
        most_after = begin if self.order else 0
        for _ in range(element.count):
            for name, size, count in steps:
                length = 1
                if count is not None:
                    length = self._length_at(at, count, most_after)
                    lengths[name].append(length)
                    at += count.size
                places[name].append(at)
                at += size * length
        if at > len(self.data):
            raise _truncated(element)

        def values(name: str, counts: Int64) -> AnyArray:
            kind = kinds[name]
            anywhere = max(len(self.data) - kind.itemsize + 1, 0)
            overlapping: AnyArray = np.ndarray((anywhere,), kind, self.data, 0, (1,))
            return overlapping[_ranges(np.array(places[name], np.int64), counts, kind.itemsize)]

        lists = {}
        for name, each in lengths.items():
            counts = np.array(each, np.int64)
            lists[name] = Lists(counts, values(name, counts))
        once = np.ones(element.count, np.int64)
        columns = {name: _as_double(values(name, once)) for name in kinds if name not in lists}
        return Table(columns, lists), at

    def _length_at(self, at: int, reader: struct.Struct, begin: int) -> int:
        """Return the length of the list at a place, at most that of the data after ``begin``."""
        if at + reader.size > len(self.data):
            raise UnreadableError("truncated: it ends within a list: get the complete file")
        (length,) = reader.unpack_from(self.data, at)
        most = (len(self.data) - begin) // (1 if self.order else reader.size)
        if not (0 <= length <= most and length == int(length)):
            said = f"{length}" if self.order else f"{length:g}"
            damaged = "damaged or truncated" if self.order else "damaged"
            raise UnreadableError(f"a list of {said} numbers: the file is {damaged}")
        return int(length)


def _count_of(one: Property) -> str:
    # No property has a name with a space.
    return f"count {one.name}"


def _of_records(element: Element, rows: AnyArray) -> Table:
    columns: dict[str, Float64] = {}
    lists: dict[str, Lists] = {}
    for one in element.properties:
        values = rows[one.name]
        if one.count:
            lengths = np.full(len(rows), values.shape[1], np.int64)
            lists[one.name] = Lists(lengths, values.ravel())
        else:
            columns[one.name] = _as_double(values)
    return Table(columns, lists)


def _as_double(values: AnyArray) -> Float64:
    with np.errstate(invalid="ignore"):  # a signalling NaN becomes a quiet one
        return values.astype(np.float64)


def _reader(kind: np.dtype[Any]) -> struct.Struct:
    """Return a struct that reads one number of a type, which is faster than NumPy."""
    return struct.Struct((">" if kind.str[0] == ">" else "<") + kind.char)


def _ranges(begins: Int64, lengths: Int64, step: int) -> Int64:
    """Return the concatenated ranges ``begin, begin + step, ...`` of the given lengths."""
    within = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    return np.asarray(np.repeat(begins, lengths) + step * within, np.int64)


def _truncated(element: Element) -> UnreadableError:
    return UnreadableError(
        f"truncated: it has fewer than the {element.count} {element.name} elements of its header: "
        "get the complete file"
    )
