"""Numbers and texts in the directories of TIFF files, which camera RAW and Exif blocks are too."""

from __future__ import annotations

import struct
from collections.abc import Collection
from typing import BinaryIO, Final, NamedTuple

from acquisition._text_files import text_of

Value = float | str
Tags = dict[int, Value]

EXIF_DIRECTORY: Final = 34665
# Classic TIFF and the variants of Olympus (two) and Panasonic; 43 is BigTIFF.
_CLASSIC: Final = (42, 0x4F52, 0x5352, 0x55)
_BIG: Final = 43
# TIFF 6.0, section 2, and BigTIFF: formats of the types of fields; rationals are two numbers.
_FORMATS: Final = {
    1: "B", 3: "H", 4: "I", 5: "II", 6: "b", 8: "h", 9: "i", 10: "ii", 11: "f", 12: "d",
    13: "I", 16: "Q", 17: "q", 18: "Q",
}  # fmt: skip
_TEXT: Final = 2
_LONGEST_TEXT: Final = 256
# Directories of damaged files claim more; cameras write a few hundred.
_MOST_ENTRIES: Final = 4096


_Entry = tuple[int, int, int, bytes]


class _Form(NamedTuple):
    """Byte order and sizes of a TIFF structure: of the count of entries, of an entry, of a word."""

    order: str
    number: str
    word: str

    @property
    def entry(self) -> struct.Struct:
        return struct.Struct(f"{self.order}HH{self.word}{struct.calcsize(self.word)}s")


def tiff_tags(file: BinaryIO, wanted: Collection[int], page: int = 0) -> Tags:
    """Return tags of a page and of its Exif directory: the first value of each, or its text.

    Anything that is not a TIFF structure, or damaged, has no tags: what a file does not state is no
    error here. Numbers that are infinite or not defined are left out.

    Parameters
    ----------
    file
        The file or block, at any place; its first byte is the begin of the TIFF structure.
    wanted
        Numbers of the tags.
    page
        Number of the page from 0; a page that does not exist has no tags.
    """
    try:
        file.seek(0)
        head = file.read(16)
        form, begin = _head(head)
        for _ in range(page):
            _, begin = _entries(file, form, begin)
        own, _ = _entries(file, form, begin)
        tags = _values(file, form, own, {*wanted, EXIF_DIRECTORY})
        exif = tags.pop(EXIF_DIRECTORY, None)
        if isinstance(exif, float):
            inner, _ = _entries(file, form, int(exif))
            tags |= _values(file, form, inner, wanted)
    # OSError: a place that no file can have.
    except (struct.error, ValueError, OverflowError, OSError):
        return {}
    return tags


def _head(head: bytes) -> tuple[_Form, int]:
    """Return the form of a TIFF structure and the place of its first directory."""
    order = {b"II": "<", b"MM": ">"}.get(head[:2])
    if order is None:
        raise ValueError("no TIFF structure")
    (magic,) = struct.unpack_from(f"{order}H", head, 2)
    if magic in _CLASSIC:
        return _Form(order, "H", "I"), struct.unpack_from(f"{order}I", head, 4)[0]
    if magic == _BIG:
        return _Form(order, "Q", "Q"), struct.unpack_from(f"{order}Q", head, 8)[0]
    raise ValueError("no TIFF structure")


def _entries(file: BinaryIO, form: _Form, begin: int) -> tuple[list[_Entry], int]:
    """Return the entries of a directory, and the place of the next one; 0 has no entries."""
    if not begin:
        raise ValueError("no such directory")
    file.seek(begin)
    size = struct.calcsize(f"{form.order}{form.number}")
    (count,) = struct.unpack(f"{form.order}{form.number}", file.read(size))
    if count > _MOST_ENTRIES:
        raise ValueError("a damaged directory")
    entry, word = form.entry, struct.Struct(f"{form.order}{form.word}")
    data = file.read(count * entry.size)
    after = file.read(word.size)
    entries = list(entry.iter_unpack(data[: len(data) // entry.size * entry.size]))
    return entries, word.unpack(after)[0] if len(after) == word.size else 0


def _values(
    file: BinaryIO,
    form: _Form,
    entries: list[_Entry],
    wanted: Collection[int],
) -> Tags:
    tags: Tags = {}
    for tag, kind, count, field in entries:
        if tag not in wanted or not count:
            continue
        if kind == _TEXT:
            size = min(count, _LONGEST_TEXT)
        elif kind in _FORMATS:
            size = struct.calcsize(f"<{_FORMATS[kind]}")
        else:
            continue
        # The first of several values counts; they are elsewhere if all do not fit into the field.
        fits = size * (1 if kind == _TEXT else count) <= len(field)
        if not fits:
            file.seek(struct.unpack(f"{form.order}{form.word}", field)[0])
        data = field[:size] if fits else file.read(size)
        if kind == _TEXT:
            tags[tag] = text_of(data.split(b"\0")[0]).strip()
        elif len(data) == size:
            number = _number(struct.unpack(f"{form.order}{_FORMATS[kind]}", data))
            if number is not None:
                tags[tag] = number
    return tags


def _number(parts: tuple[float, ...]) -> float | None:
    over, under = (*parts, 1)[:2]
    number = float(over) / float(under) if under else float("nan")
    return number if abs(number) < float("inf") else None
