"""Checks on the first bytes of an image file: its kind and, for some formats, its size.

Three decoders unpack the pixels as soon as they open a file; for their formats the size is checked
here.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from rig import UnreadableError
from rig.files import check_pixels, read_head

_HEAD: Final = 4096
_SIGNATURES: Final = {
    "png": rb"\x89PNG\r\n\x1a\n",
    "tiff": rb"II[*+]\0|MM\0[*+]",
    "exr": rb"v/1\x01",
    "jpeg": rb"\xff\xd8\xff",
    "bmp": rb"BM",
    "hdr": rb"#\?(RADIANCE|RGBE)",
    "jpeg 2000": rb"\0\0\0\x0cjP  |\xff\x4f\xff\x51",
    "jpeg xl": rb"\xff\x0a|\0\0\0\x0cJXL ",
    "webp": rb"RIFF.{4}WEBP",
    "pnm": rb"P[1-6Ff]\s",
    "dpx": rb"SDPX|XPDS",
}
# What files with the suffix of an image also contain.
_OTHERS: Final = {
    "a GIF file": rb"GIF8",
    "a HEIF image": rb".{4}ftyp(heic|heix|hevc|mif1|msf1|avif|avis)",
    "a Photoshop file": rb"8BPS",
    "a PDF file": rb"%PDF",
    "a MAT-file": rb"MATLAB",
    "a web page": rb"\s*<(!doctype|html)",
    "text": rb"[\t\n\r -~]{64}",
}
# Truevision's format has no signature at its beginning.
_TARGA_SUFFIXES: Final = (".tga", ".tpic")


def kind_of(head: bytes, suffix: str) -> str | None:
    """Return the kind of an image by its first bytes; None if it is not a supported kind."""
    for kind, signature in _SIGNATURES.items():
        if re.match(signature, head, re.DOTALL):
            return kind
    return "targa" if suffix.lower() in _TARGA_SUFFIXES and len(head) > 18 else None


def check_image_head(path: Path, max_pixels: int) -> int:
    """Refuse files that are not images or are too large; return the size of the file in bytes.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    UnreadableError
        If it is not a regular file, is empty, is not an image of a supported kind, or is of a kind
        that is unpacked when opened and declares too many pixels.
    """
    head, file_bytes = read_head(path, _HEAD)
    kind = kind_of(head, path.suffix)
    if kind is None:
        raise UnreadableError(f"not a readable image: {_what_else(head)}")
    size = _SIZES[kind](head) if kind in _SIZES else None
    if size is not None:
        check_pixels(*size, 8, file_bytes, max_pixels)
    elif kind in _SIZES:
        raise UnreadableError(f"not a readable image: its {kind} header is damaged: copy it again")
    return file_bytes


def _what_else(head: bytes) -> str:
    """Return what a file is that is not an image of a supported kind, and what to do."""
    if not head:
        return "it is empty: copy it again"
    instead = "replace it with the image, saved as PNG, TIFF or JPEG"
    for name, signature in _OTHERS.items():
        if re.match(signature, head, re.DOTALL | re.IGNORECASE):
            return f"it is {name}, whatever its name: {instead}"
    return f"its first bytes match no supported format: copy it again, or {instead}"


def _jpeg_2000(head: bytes) -> tuple[int, int] | None:
    """Read the size from the SIZ marker: ISO/IEC 15444-1, A.5.1."""
    at = head.find(b"\xff\x4f\xff\x51")
    if at < 0 or len(head) < at + 24:
        return None
    right, bottom, left, top = (
        int.from_bytes(head[at + 8 + 4 * i : at + 12 + 4 * i]) for i in range(4)
    )
    return right - left, bottom - top


def _webp(head: bytes) -> tuple[int, int] | None:
    """Read the size from the canvas or the frame header: RFC 9649."""
    kind, body = head[12:16], head[20:]
    if len(body) < 10:
        return None
    match kind:
        case b"VP8X":
            return _little(body[4:7]) + 1, _little(body[7:10]) + 1
        case b"VP8L":
            bits = _little(body[1:5])
            return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
        case b"VP8 ":
            return _little(body[6:8]) & 0x3FFF, _little(body[8:10]) & 0x3FFF
    return None


def _jpeg_xl(head: bytes) -> tuple[int, int] | None:
    """Read the size from the SizeHeader: ISO/IEC 18181-1, 5.3."""
    at = 0
    if head[:2] != b"\xff\x0a":
        boxes = [head.find(name) for name in (b"jxlc", b"jxlp")]
        at = max(boxes) + (4 if boxes[0] > boxes[1] else 8)
        if max(boxes) < 0 or head[at : at + 2] != b"\xff\x0a":
            return None
    bits = _Bits(head[at + 2 : at + 14])
    if len(head) < at + 14:
        return None
    small = bits.take(1)
    height = 8 * (bits.take(5) + 1) if small else bits.take((9, 13, 18, 30)[bits.take(2)]) + 1
    ratio = bits.take(3)
    if ratio:
        over, under = ((1, 1), (12, 10), (4, 3), (3, 2), (16, 9), (5, 4), (2, 1))[ratio - 1]
        return height * over // under, height
    width = 8 * (bits.take(5) + 1) if small else bits.take((9, 13, 18, 30)[bits.take(2)]) + 1
    return width, height


class _Bits:
    def __init__(self, data: bytes) -> None:
        self._rest = _little(data)

    def take(self, count: int) -> int:
        value = self._rest & ((1 << count) - 1)
        self._rest >>= count
        return value


def _little(data: bytes) -> int:
    return int.from_bytes(data, "little")


_SIZES: Final = {"jpeg 2000": _jpeg_2000, "webp": _webp, "jpeg xl": _jpeg_xl}
