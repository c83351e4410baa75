"""Decoding of a buffer's bytes to pixels: raw formats of the Pixel Format Naming Convention."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from rig._errors import CameraError
from rig.arrays import UInt8, UInt16

_NAME = re.compile(
    r"(Mono|Bayer(?P<first>RG|GR|GB|BG))(?P<depth>8|10|12|14|16)(?P<packing>p|Packed|)"
)
_CFA = {"RG": "RGGB", "GR": "GRBG", "GB": "GBRG", "BG": "BGGR"}
# Best first. The 16-bit formats are second to last, before 8: few sensors have 16 bits, and many
# cameras then place fewer bits at the high end.
_PREFERRED = ("12", "12p", "12Packed", "14", "10", "10p", "10Packed", "16", "8")
_BLOCK = 1 << 16  # groups of pixels unpacked at a time, so that they stay in the cache


@dataclass(frozen=True)
class PixelFormat:
    """A format of raw samples.

    Parameters
    ----------
    name
        Name of the format, for instance Mono12p.
    depth
        Bits per sample.
    packing
        "" if each sample has its own bytes, "p" for the convention's packing, "Packed" for the
        packing of GigE Vision.
    cfa
        Colour filter pattern, for instance "RGGB"; None for monochrome.
    """

    name: str
    depth: int
    packing: str
    cfa: str | None

    @classmethod
    def of(cls, name: str) -> PixelFormat | None:
        """Return the format of this name, None if it is not a format of raw samples."""
        match = _NAME.fullmatch(name)
        if match is None:
            return None
        depth, packing = int(match["depth"]), match["packing"]
        if packing and depth not in (10, 12):
            return None
        return cls(name, depth, packing, _CFA.get(match["first"]))

    @property
    def group(self) -> tuple[int, int]:
        """Number of pixels in a group, and number of bytes that they share."""
        if not self.packing:
            return 1, 1 if self.depth == 8 else 2
        if self.packing == "Packed":
            return 2, 3
        bits = math.lcm(self.depth, 8)
        return bits // self.depth, bits // 8

    def bytes_of(self, pixels: int) -> int:
        """Return the number of bytes of a run of pixels."""
        count, size = self.group
        if self.packing == "p":
            return -(-pixels * self.depth // 8)
        return -(-pixels // count) * size


def best_format(offered: Iterable[str]) -> str | None:
    """Return the default format: raw colour is preferred to mono, and 12 bits to other depths."""
    known = [found for name in offered if (found := PixelFormat.of(name)) is not None]
    return min(known, key=_rank).name if known else None


def _rank(form: PixelFormat) -> tuple[bool, int, str]:
    return form.cfa is None, _PREFERRED.index(f"{form.depth}{form.packing}"), form.name


def decode(
    raw: bytes | memoryview,
    form: PixelFormat,
    *,
    size: tuple[int, int],
    padding: int = 0,
    big_endian: bool = False,
    camera: str = "",
) -> UInt16:
    """Return the pixels of a buffer as a copy.

    Parameters
    ----------
    raw
        The buffer's content from the image's first byte; bytes after the image are ignored.
    form
        Format of the pixels.
    size
        (H, W).
    padding
        Bytes after each row. Without padding, a packed row may begin within a byte, as the
        convention specifies, unless the number of bytes shows that each row begins a new byte.
    big_endian
        Byte order of samples of two bytes.
    camera
        Name of the camera in messages.

    Returns
    -------
    numpy.ndarray
        ``(H, W)`` uint16, samples in the low bits.

    Raises
    ------
    CameraError
        If there are too few bytes for this image; if there are too many and the rows could be of
        either kind; or if a sample has more bits than the format.
    """
    height, width = size
    stride = form.bytes_of(width) + padding
    content = np.frombuffer(raw, np.uint8)
    total, joined = stride * height, form.bytes_of(width * height)
    if not padding and (len(content) == joined or (len(content) > joined == total)):
        content = content[np.newaxis, :joined]
        pixels = _unpack(content, form, width * height, big_endian).reshape(size)
    elif len(content) == total or (padding and len(content) > total):
        rows = content[:total].reshape(height, stride)[:, : stride - padding]
        pixels = _unpack(rows, form, width, big_endian)
    else:
        raise CameraError(
            f"camera {camera}: a {form.name} frame of {width} x {height} pixels with {padding} "
            f"bytes of padding per row has {total} bytes, but this one has {len(content)}; "
            "check the camera's PixelFormat, Width and Height"
        )
    if not form.packing and form.depth not in (8, 16) and int(pixels.max()) >> form.depth:
        raise CameraError(
            f"camera {camera}: a sample of {pixels.max()} in a {form.name} frame does not fit into "
            f"{form.depth} bits; choose another pixel format"
        )
    return pixels


def _unpack(rows: UInt8, form: PixelFormat, width: int, big_endian: bool) -> UInt16:
    """Unpack each row to ``width`` pixels."""
    if form.depth == 8:
        return rows.astype(np.uint16)
    if not form.packing:
        return np.ascontiguousarray(rows).view(">u2" if big_endian else "<u2").astype(np.uint16)
    count, size = form.group
    groups = -(-width // count)
    if rows.shape[1] < groups * size:
        rows = np.pad(rows, ((0, 0), (0, groups * size - rows.shape[1])))
    packed = np.ascontiguousarray(rows).reshape(-1, size)
    pixels = np.zeros((len(packed), count), np.uint16)
    for start in range(0, len(packed), _BLOCK):
        block = packed[start : start + _BLOCK].astype(np.uint16)
        for index in range(count):
            pixels[start : start + _BLOCK, index] = _sample(block, index, form)
    return np.ascontiguousarray(pixels.reshape(len(rows), groups * count)[:, :width])


def _sample(block: UInt16, index: int, form: PixelFormat) -> UInt16:
    """Return the sample at one place of each group of bytes."""
    if form.packing == "Packed":
        # Each pixel has its own byte for the high bits; both share the middle byte.
        low = form.depth - 8
        shared = block[:, 1] >> 4 * index & (1 << low) - 1
        return (block[:, 2 * index] << low | shared).astype(np.uint16, copy=False)
    first, shift = divmod(index * form.depth, 8)
    both = block[:, first] | block[:, first + 1] << 8
    return (both >> shift & (1 << form.depth) - 1).astype(np.uint16, copy=False)
