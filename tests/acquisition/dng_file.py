"""Camera RAW files for tests."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from rig.arrays import UInt16

Tag = tuple[int, int, int, bytes]
_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _SRATIONAL = 1, 2, 3, 4, 5, 10
SHORT, SRATIONAL = _SHORT, _SRATIONAL
_LAYOUT = {_BYTE: "B", _SHORT: "H", _LONG: "I", _RATIONAL: "I", _SRATIONAL: "i"}


def tag(number: int, kind: int, values: bytes | tuple[int, ...]) -> Tag:
    if isinstance(values, bytes):
        return number, kind, len(values), values
    count = len(values) // (2 if kind in (_RATIONAL, _SRATIONAL) else 1)
    return number, kind, count, struct.pack(f"<{len(values)}{_LAYOUT[kind]}", *values)


def directory(tags: list[Tag], at: int) -> bytes:
    """Build a TIFF directory for this offset, followed by values too long for its entries."""
    entries, extra = b"", b""
    after = at + 2 + 12 * len(tags) + 4
    for number, kind, count, data in sorted(tags):
        value = data.ljust(4, b"\0") if len(data) <= 4 else struct.pack("<I", after + len(extra))
        extra += b"" if len(data) <= 4 else data + b"\0" * (len(data) % 2)
        entries += struct.pack("<HHI", number, kind, count) + value
    return struct.pack("<H", len(tags)) + entries + b"\0\0\0\0" + extra


def dng(
    pixels: UInt16,
    *,
    black: tuple[int, int, int, int] = (64, 64, 64, 64),
    white: int = 4095,
    active: tuple[int, int, int, int] | None = None,
    orientation: int = 1,
    cfa: tuple[int, int, int, int] = (0, 1, 1, 2),
    exposure: tuple[int, int] = (1, 200),
    iso: int = 400,
    taken: str = "2026:01:02 03:04:05",
    other: Sequence[Tag] = (),
) -> bytes:
    """Build an uncompressed DNG file (Adobe's specification 1.4); ``active`` is top, left, ...

    Tags of ``other`` are added, or replace those of the same number.
    """
    height, width = pixels.shape
    samples = pixels.astype("<u2").tobytes()
    exif = [
        tag(33434, _RATIONAL, exposure),
        tag(34855, _SHORT, (iso,)),
        tag(36867, _ASCII, taken.encode() + b"\0"),
    ]
    matrix = tuple(number for i in range(9) for number in (int(i % 4 == 0), 1))

    def tags(exif_at: int, samples_at: int) -> list[Tag]:
        usual = [
            tag(254, _LONG, (0,)),
            tag(256, _LONG, (width,)),
            tag(257, _LONG, (height,)),
            tag(258, _SHORT, (16,)),
            tag(259, _SHORT, (1,)),
            tag(262, _SHORT, (32803,)),
            tag(271, _ASCII, b"Acme\0"),
            tag(272, _ASCII, b"Acme One\0"),
            tag(273, _LONG, (samples_at,)),
            tag(274, _SHORT, (orientation,)),
            tag(277, _SHORT, (1,)),
            tag(278, _LONG, (height,)),
            tag(279, _LONG, (len(samples),)),
            tag(284, _SHORT, (1,)),
            tag(33421, _SHORT, (2, 2)),
            tag(33422, _BYTE, cfa),
            tag(34665, _LONG, (exif_at,)),
            tag(50706, _BYTE, (1, 4, 0, 0)),
            tag(50708, _ASCII, b"Acme One\0"),
            tag(50713, _SHORT, (2, 2)),
            tag(50714, _SHORT, black),
            tag(50717, _SHORT, (white,)),
            tag(50721, _SRATIONAL, matrix),
            *([] if active is None else [tag(50829, _LONG, active)]),
        ]
        return [*({each[0]: each for each in (*usual, *other)}.values())]

    exif_at = 8 + len(directory(tags(0, 0), 8))
    samples_at = exif_at + len(directory(exif, exif_at))
    head = directory(tags(exif_at, samples_at), 8) + directory(exif, exif_at)
    return struct.pack("<2sHI", b"II", 42, 8) + head + samples
