"""What image files state about the shot: Exif, which is a TIFF structure, and XMP packets."""

from __future__ import annotations

import io
import math
import re
import struct
import zlib
from collections.abc import Callable, Collection
from functools import partial
from itertools import islice
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

from acquisition.files.text_files import text_of
from acquisition.pixels.image_head import kind_of
from acquisition.pixels.png_file import chunk, chunks_before_samples

Value = float | str
Tags = dict[int, Value]

EXIF_DIRECTORY: Final = 34665
# Classic TIFF and the variants of Olympus (two) and Panasonic; 43 is BigTIFF.
_CLASSIC: Final = (42, 0x4F52, 0x5352, 0x55)
_BIG: Final = 43
# TIFF 6.0, section 2, and BigTIFF: formats of the types of fields; rationals are two numbers.
FORMATS: Final = {
    1: "B", 3: "H", 4: "I", 5: "II", 6: "b", 8: "h", 9: "i", 10: "ii", 11: "f", 12: "d",
    13: "I",
}  # fmt: skip
_FORMATS: Final = FORMATS | {16: "Q", 17: "q", 18: "Q"}
_TEXT: Final = 2
_LONGEST_TEXT: Final = 256
# Directories of damaged files claim more; cameras write a few hundred.
_MOST_ENTRIES: Final = 4096

# Tag, type, count, and the values or their place.
Entry = tuple[int, int, int, bytes]
# A segment of JPEG holds at most 64 kB; the blocks of other formats are of this size too.
_MOST_BYTES: Final = 1 << 20
# More parts of a file are not searched for its block.
_MOST_PARTS: Final = 1 << 12
_TAIL: Final = 1 << 17
_PREFIX: Final = b"Exif\0\0"
_RAW_PROFILE: Final = re.compile(rb"Raw profile type (?:exif|APP1)\0")
_START_OF_SCAN: Final = 0xDA
# XMP, part 2: the properties have the names of Exif's tags.
_TAG_OF: Final = {
    "ExposureTime": 33434, "FNumber": 33437, "ISOSpeedRatings": 34855,
    "PhotographicSensitivity": 34855, "ShutterSpeedValue": 37377, "ApertureValue": 37378,
    "FocalLength": 37386, "PixelXDimension": 40962, "PixelYDimension": 40963,
    "FocalPlaneXResolution": 41486, "FocalPlaneYResolution": 41487,
    "FocalPlaneResolutionUnit": 41488, "DigitalZoomRatio": 41988, "FocalLengthIn35mmFilm": 41989,
}  # fmt: skip
# An attribute, an element, or the first item of a list in it.
_PROPERTY: Final = re.compile(
    rb"\bexif(?:EX)?:(" + "|".join(_TAG_OF).encode() + rb")(?:\s*=\s*[\"']|>\s*"
    rb"(?:<rdf:Seq[^>]*>\s*<rdf:li[^>]*>\s*)?)([0-9./eE+-]{1,40})\s*[\"'<]"
)
_BEGIN, _FINISH = b"<x:xmpmeta", b"</x:xmpmeta>"
# XMP, part 3: a packet can be found without its container. It is before or after the samples.
_SEARCHED: Final = 1 << 18


class Form(NamedTuple):
    """Byte order and sizes of a TIFF structure: of the count of entries, of an entry, of a word."""

    order: str
    number: str
    word: str

    def directory(self, file: BinaryIO, begin: int, most: int = 1 << 16) -> tuple[list[Entry], int]:
        """Return the entries of a directory, at most so many, and the place of the next one or 0.

        Raises
        ------
        ValueError, struct.error
            If the directory is damaged.
        """
        file.seek(begin)
        number = struct.Struct(self.order + self.number)
        word = struct.Struct(self.order + self.word)
        (count,) = number.unpack(file.read(number.size))
        if count > most:
            raise ValueError("a damaged directory")
        entry = struct.Struct(f"{self.order}HH{self.word}{word.size}s")
        data = file.read(count * entry.size)
        after = file.read(word.size)
        entries = list(entry.iter_unpack(data[: len(data) // entry.size * entry.size]))
        return entries, word.unpack(after)[0] if len(after) == word.size else 0

    def values(self, file: BinaryIO, field: bytes, size: int, whole: int) -> bytes:
        """Return the first bytes of the values of an entry, of which there are ``whole``."""
        if whole <= len(field):
            return field[:size]
        file.seek(struct.unpack(self.order + self.word, field)[0])
        return file.read(size)


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


def _head(head: bytes) -> tuple[Form, int]:
    """Return the form of a TIFF structure and the place of its first directory."""
    order = {b"II": "<", b"MM": ">"}.get(head[:2])
    if order is None:
        raise ValueError("no TIFF structure")
    (magic,) = struct.unpack_from(f"{order}H", head, 2)
    if magic in _CLASSIC:
        return Form(order, "H", "I"), struct.unpack_from(f"{order}I", head, 4)[0]
    if magic == _BIG:
        return Form(order, "Q", "Q"), struct.unpack_from(f"{order}Q", head, 8)[0]
    raise ValueError("no TIFF structure")


def _entries(file: BinaryIO, form: Form, begin: int) -> tuple[list[Entry], int]:
    if not begin:
        raise ValueError("no such directory")
    return form.directory(file, begin, _MOST_ENTRIES)


def _values(file: BinaryIO, form: Form, entries: list[Entry], wanted: Collection[int]) -> Tags:
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
        data = form.values(file, field, size, size * (1 if kind == _TEXT else count))
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


def exif_tags(path: Path, wanted: Collection[int], page: int = 0) -> Tags:
    """Return the wanted tags of a file that exists; none if it states none.

    Parameters
    ----------
    path
        TIFF, camera RAW on its basis, JPEG, PNG, WebP, JPEG 2000 or XL; others have no tags.
    wanted
        Numbers of the tags.
    page
        Number of the page of a TIFF. What it does not state, the first page states.
    """
    with path.open("rb", buffering=0) as file:
        head = file.read(16)
        finder = _FINDERS.get(kind_of(head, "") or "")
        if finder is None:
            return {**tiff_tags(file, wanted), **(tiff_tags(file, wanted, page) if page else {})}
        file.seek(0)
        block = finder(file)
    return tiff_tags(io.BytesIO(block.removeprefix(_PREFIX)), wanted)


def _jpeg(file: BinaryIO) -> bytes:
    """Return the APP1 segment with Exif (Exif 2.32, 4.7.2), which is before the first scan."""
    file.seek(2)
    for _ in range(_MOST_PARTS):
        marker = file.read(2)
        while marker[1:] == b"\xff":
            marker = b"\xff" + file.read(1)
        if len(marker) < 2 or marker[0] != 0xFF or marker[1] == _START_OF_SCAN:
            break
        size = int.from_bytes(file.read(2)) - 2
        if marker[1] == 0xE1:
            data = file.read(max(size, 0))
            if data.startswith(_PREFIX):
                return data
        else:
            file.seek(max(size, 0), io.SEEK_CUR)
    return b""


def _png(file: BinaryIO) -> bytes:
    """Return the eXIf chunk (PNG 3, 11.3.4.5), before the samples or near the end of the file."""
    for kind, size in islice(chunks_before_samples(file), _MOST_PARTS):
        if kind == b"eXIf":
            return file.read(min(size, _MOST_BYTES))
        is_text = kind in (b"zTXt", b"tEXt") and size < _MOST_BYTES
        if is_text and (block := _raw_profile(file.read(size), packed=kind == b"zTXt")):
            return block
    # A walk over the samples, in chunks of 8 kB, takes longer than all else.
    file.seek(max(file.seek(0, io.SEEK_END) - _TAIL, 0))
    tail = file.read(_TAIL)
    at = tail.rfind(b"eXIf")
    size = int.from_bytes(tail[max(at - 4, 0) : max(at, 0)])
    data = tail[at + 4 : at + 4 + size]
    return data if at >= 0 and chunk(b"eXIf", data) in tail else b""


def _raw_profile(text: bytes, *, packed: bool) -> bytes:
    """Return the block that Exiv2 and ImageMagick write as text: its length, then hexadecimal."""
    match = _RAW_PROFILE.match(text)
    if match is None:
        return b""
    try:
        body = text[match.end() :]
        if packed:
            body = zlib.decompressobj().decompress(body[1:], 2 * _MOST_BYTES)
        # After the lines of its name and its length.
        block = bytes.fromhex("".join(body.decode("ascii").strip().split("\n")[2:]))
    except (ValueError, zlib.error):
        return b""
    return block if block.startswith(_PREFIX) else b""


def _webp(file: BinaryIO) -> bytes:
    """Return the EXIF chunk: RFC 9649, 2.7.1.5."""
    file.seek(12)
    for _ in range(_MOST_PARTS):
        head = file.read(8)
        if len(head) < 8:
            break
        size = int.from_bytes(head[4:], "little")
        if head[:4] == b"EXIF":
            return file.read(min(size, _MOST_BYTES))
        file.seek(size + size % 2, io.SEEK_CUR)
    return b""


def _box(kind: bytes, before: int, file: BinaryIO) -> bytes:
    """Return the block in a box of a kind, which has so many bytes before it."""
    for _ in range(_MOST_PARTS):
        head = file.read(8)
        size = int.from_bytes(head[:4])
        if len(head) < 8 or size < 8:
            break
        begin = file.tell()
        if head[4:] == kind:
            block = file.read(min(size - 8, _MOST_BYTES))[before:]
            if block.startswith((b"II", b"MM", _PREFIX)):
                return block
        file.seek(begin + size - 8)
    return b""


# JPEG XL has the offset of the TIFF structure before it (ISO/IEC 18181-2, 9.4), JPEG 2000 an
# identifier.
_FINDERS: Final[dict[str, Callable[[BinaryIO], bytes]]] = {
    "jpeg": _jpeg,
    "png": _png,
    "webp": _webp,
    "jpeg xl": partial(_box, b"Exif", 4),
    "jpeg 2000": partial(_box, b"uuid", 16),
}


def xmp_tags(path: Path, wanted: Collection[int]) -> Tags:
    """Return the wanted tags that the first packet of a file states; none without a packet."""
    with path.open("rb") as file:
        data = file.read(_SEARCHED)
        end = file.seek(0, 2)
        file.seek(max(end - _SEARCHED, len(data)))
        data += file.read()
    begin = data.find(_BEGIN)
    packet = data[begin : data.find(_FINISH, begin)] if begin >= 0 else b""
    tags: Tags = {}
    for name, value in _PROPERTY.findall(packet):
        number = number_of(value.decode("ascii"))
        tag = _TAG_OF[name.decode("ascii")]
        if number is not None and tag in wanted:
            tags.setdefault(tag, number)
    return tags


def number_of(text: str) -> float | None:
    """Return the value of a number or a rational such as ``1/60``; None if it is neither.

    Examples
    --------
    >>> from acquisition.pixels.exif_block import number_of
    >>> number_of("1/80"), number_of("0/0")
    (0.0125, None)
    """
    numerator, _, denominator = text.partition("/")
    try:
        value = float(numerator) / float(denominator or 1)
    except (ValueError, ZeroDivisionError, OverflowError):
        return None
    return value if math.isfinite(value) else None
