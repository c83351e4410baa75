"""Image files from hand-made bytes, and from the library without our writers."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813

RGB = np.arange(4 * 5 * 3, dtype=np.uint8).reshape(4, 5, 3) * 4


RGB16 = RGB.astype(np.uint16) * 257 + 13


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png(rows: np.ndarray, depth: int, colour: int, *extra: bytes) -> bytes:
    """Build a PNG file from rows that are already packed into bytes."""
    height = len(rows)
    per_pixel = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[colour] * depth
    width = rows.shape[1] * 8 // per_pixel
    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    body = b"".join(b"\0" + row.tobytes() for row in rows)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + b"".join(extra)
        + chunk(b"IDAT", zlib.compress(body))
        + chunk(b"IEND", b"")
    )


def tga(pixels: np.ndarray, descriptor: int) -> bytes:
    height, width = pixels.shape[:2]
    bits = 8 * (pixels.shape[2] if pixels.ndim == 3 else 1)
    kind = 3 if bits == 8 else 2
    return struct.pack(
        "<BBBHHBHHHHBB", 0, 0, kind, 0, 0, 0, 0, 0, width, height, bits, descriptor
    ) + (pixels.tobytes())


def by_library(path: Path, pixels: np.ndarray, names: tuple[str, ...] = (), **hints: Any) -> Path:
    """Write a file with OpenImageIO directly, for images that our writers refuse."""
    pixels = np.ascontiguousarray(pixels.reshape(*pixels.shape[:2], -1))
    kinds = {
        "uint8": oiio.UINT8,
        "int16": oiio.INT16,
        "uint16": oiio.UINT16,
        "uint32": oiio.UINT32,
        "float16": oiio.HALF,
        "float32": oiio.FLOAT,
        "float64": oiio.DOUBLE,
    }
    spec = oiio.ImageSpec(*pixels.shape[1::-1], pixels.shape[2], kinds[pixels.dtype.name])
    if names:
        spec.channelnames = names
    for key, value in hints.items():
        spec.attribute(key, value)
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), spec)
    assert file.write_image(pixels)
    assert file.close()
    return path


BIG = RGB16.astype(">u2").view(np.uint8).reshape(4, -1)


NOISE = np.random.default_rng(5).integers(0, 65535, (40, 30, 3)).astype(np.uint16)
