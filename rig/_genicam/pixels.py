"""From the bytes of a buffer to pixels: raw formats of the Pixel Format Naming Convention."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from rig._errors import CameraError

_NAME = re.compile(
    r"(Mono|Bayer(?P<first>RG|GR|GB|BG))(?P<depth>8|10|12|14|16)(?P<packing>p|Packed|)"
)
_CFA = {"RG": "RGGB", "GR": "GRBG", "GB": "GBRG", "BG": "BGGR"}
# Best first. Formats of 16 bits come last but for 8: few sensors have them, and many cameras then
# put fewer bits at the high end.
_PREFERRED = ("12", "12p", "12Packed", "14", "10", "10p", "10Packed", "16", "8")
_BLOCK = 1 << 16  # groups of pixels unpacked at a time, so that they stay in the cache


@dataclass(frozen=True)
class PixelFormat:
    """A format of raw samples.

    Parameters
    ----------
    name
        For instance Mono12p.
    depth
        Bits of a sample.
    packing
        "" where each sample has bytes of its own, "p" for the convention's packing, "Packed" for
        that of GigE Vision.
    cfa
        "RGGB" and the like, None for monochrome.
    """

    name: str
    depth: int
    packing: str
    cfa: str | None

    @classmethod
    def of(cls, name: str) -> PixelFormat | None:
        """Return the format of this name, None where it is none of raw samples."""
        match = _NAME.fullmatch(name)
        if match is None:
            return None
        depth, packing = int(match["depth"]), match["packing"]
        if packing and depth not in (10, 12):
            return None
        return cls(name, depth, packing, _CFA.get(match["first"]))

    @property
    def group(self) -> tuple[int, int]:
        """How many pixels share how many bytes."""
        if not self.packing:
            return 1, 1 if self.depth == 8 else 2
        if self.packing == "Packed":
            return 2, 3
        bits = math.lcm(self.depth, 8)
        return bits // self.depth, bits // 8

    def bytes_of(self, pixels: int) -> int:
        """Return how many bytes a run of pixels fills."""
        count, size = self.group
        if self.packing == "p":
            return -(-pixels * self.depth // 8)
        return -(-pixels // count) * size


def best_format(offered: Iterable[str]) -> str | None:
    """Return the format to take where none is asked for: raw colour before mono, 12 bits first."""
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
) -> npt.NDArray[np.uint16]:
    """Return the pixels of a buffer as a copy.

    Parameters
    ----------
    raw
        The buffer's content, from the image's first byte on; what follows the image is ignored.
    form
        What they are.
    size
        (H, W).
    padding
        Bytes after each row. Without any, packed rows follow each other within a byte, as the
        convention has it, unless the number of bytes says that each begins with a byte of its own.
    big_endian
        Of samples of two bytes.
    camera
        Named in messages.

    Returns
    -------
    numpy.ndarray
        ``(H, W)`` uint16, samples at the low end.

    Raises
    ------
    CameraError
        If there are too few bytes for such an image; if they are too many and could be rows of
        either kind; or if a sample has more bits than the format.
    """
    height, width = size
    stride = form.bytes_of(width) + padding
    content = np.frombuffer(raw, np.uint8)
    whole, joined = stride * height, form.bytes_of(width * height)
    if not padding and (len(content) == joined or (len(content) > joined == whole)):
        content = content[np.newaxis, :joined]
        pixels = _unpack(content, form, width * height, big_endian).reshape(size)
    elif len(content) == whole or (padding and len(content) > whole):
        rows = content[:whole].reshape(height, stride)[:, : stride - padding]
        pixels = _unpack(rows, form, width, big_endian)
    else:
        raise CameraError(
            f"camera {camera}: a {form.name} frame of {width} x {height} pixels with {padding} "
            f"bytes of padding per row has {whole} bytes, this one has {len(content)}; "
            "check the camera's PixelFormat, Width and Height"
        )
    if not form.packing and form.depth not in (8, 16) and int(pixels.max()) >> form.depth:
        raise CameraError(
            f"camera {camera}: a sample of {pixels.max()} in a {form.name} frame does not fit its "
            f"{form.depth} bits; choose another pixel format"
        )
    return pixels


def _unpack(
    rows: npt.NDArray[np.uint8], form: PixelFormat, width: int, big_endian: bool
) -> npt.NDArray[np.uint16]:
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


def _sample(block: npt.NDArray[np.uint16], index: int, form: PixelFormat) -> npt.NDArray[np.uint16]:
    """Return the sample at one place of each group of bytes."""
    if form.packing == "Packed":
        # Both pixels keep their high bits in a byte of their own and share the middle one.
        low = form.depth - 8
        shared = block[:, 1] >> 4 * index & (1 << low) - 1
        return (block[:, 2 * index] << low | shared).astype(np.uint16, copy=False)
    first, shift = divmod(index * form.depth, 8)
    both = block[:, first] | block[:, first + 1] << 8
    return (both >> shift & (1 << form.depth) - 1).astype(np.uint16, copy=False)
