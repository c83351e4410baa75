"""PNG files: their chunks, and files that are encoded in bands of rows and read back after writing.

zlib compresses in this process and reports every failure, unlike the encoders of the image
libraries. So a file needs no second decoding: its bytes on the disk are compared instead. Chunks
are checked before decoding, because the decoder prints errors to stderr.
"""

from __future__ import annotations

import math
import os
import struct
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np

from acquisition._errors import DataError, StorageError
from acquisition.files.map_rows import MapRows, rows_in_bands
from acquisition.files.storage import disk, library_path, open_binary, published, write_whole
from rig.arrays import Generic, UInt8

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PART: Final = 1 << 18
_COLOUR_TYPES: Final = {1: 0, 2: 4, 3: 2, 4: 6}  # by channels: grey, grey + alpha, RGB, RGBA
_SUB: Final = 1  # each byte minus that of the pixel to the left
_BAND_BYTES: Final = 1 << 20


def chunk(kind: bytes, data: bytes) -> bytes:
    """Return a complete chunk: length, kind, data and CRC."""
    head = struct.pack(">I", len(data)) + kind
    return b"".join((head, data, struct.pack(">I", zlib.crc32(data, zlib.crc32(kind)))))


# The sRGB curve, relative colorimetric, and its approximation for programs that only know gamma:
# PNG 3, 11.3.2.2 and 11.3.2.5.
SRGB_CHUNKS = (chunk(b"sRGB", b"\1"), chunk(b"gAMA", struct.pack(">I", 45455)))


def check_png(file: BinaryIO, name: str) -> None:
    """Check the CRC of every chunk of a PNG file up to its end chunk.

    The decoder accepts a file that stops after its last pixels, and the encoder does not notice a
    full disk; this check finds both. Bytes after the end chunk are allowed.

    Parameters
    ----------
    file
        The file, at its begin. It is read in parts, because it may be large.
    name
        Its name, for messages.

    Raises
    ------
    DataError
        If a chunk is truncated or altered, or the end chunk is missing.
    """
    position = len(file.read(len(SIGNATURE)))
    while True:
        head = file.read(8)
        left, crc = int.from_bytes(head[:4]), zlib.crc32(head[4:])
        size = len(head)
        while left and (part := file.read(min(left, _PART))):
            left, crc, size = left - len(part), zlib.crc32(part, crc), size + len(part)
        stored = file.read(4)
        if len(head) < 8 or len(stored) < 4:
            end = position + size + len(stored)
            raise DataError(f"{name}: PNG cut short at byte {end}: copy it again")
        if crc != int.from_bytes(stored):
            raise DataError(f"{name}: PNG damaged in the chunk at byte {position}: copy it again")
        if head[4:] == b"IEND":
            return
        position += size + 4


def chunks_before_samples(file: BinaryIO) -> Iterator[tuple[bytes, int]]:
    """Yield kind and size of each chunk before the samples, with the file at its data."""
    file.seek(len(SIGNATURE))
    while len(head := file.read(8)) == 8 and head[4:] != b"IDAT":
        size, begin = int.from_bytes(head[:4]), file.tell()
        yield head[4:], size
        file.seek(begin + size + 4)


def png_pieces(
    pixels: MapRows, alpha: MapRows | None = None, chunks: Iterable[bytes] = ()
) -> Iterator[bytes]:
    """Yield the bytes of a PNG (PNG 3, W3C 2025); equal arguments give equal bytes.

    Parameters
    ----------
    pixels
        ``(H, W)`` or ``(H, W, 3)`` RGB, uint8 or uint16, in any memory layout.
    alpha
        ``(H, W)`` of the same type, or None.
    chunks
        Complete chunks before the samples, such as the transfer curve.
    """
    height, width = pixels.shape[:2]
    channels = math.prod(pixels.shape[2:]) + (alpha is not None)
    size = pixels.dtype.itemsize
    yield SIGNATURE
    form = struct.pack(">IIBBBBB", width, height, 8 * size, _COLOUR_TYPES[channels], 0, 0, 0)
    yield chunk(b"IHDR", form)
    yield from chunks
    # Runs of equal bytes after a difference to the left: measured maps become as small as by the
    # search for repeated strings, in half of its time.
    encoder = zlib.compressobj(1, zlib.DEFLATED, 15, 9, zlib.Z_RLE)
    for rows in rows_in_bands(height, width * channels * size, _BAND_BYTES):
        band = pixels[rows].reshape(-1, width, channels - (alpha is not None))
        if alpha is not None:
            band = np.dstack([band, alpha[rows]])
        if data := encoder.compress(_filtered(band).data):
            yield chunk(b"IDAT", data)
    yield chunk(b"IDAT", encoder.flush())
    yield chunk(b"IEND", b"")


def store_png(path: Path, pieces: Iterable[bytes]) -> None:
    """Write a PNG, and compare its bytes on the disk with those that were written.

    The file appears complete and checked, or not at all.

    Raises
    ------
    DataError
        If `read_image` could not open a file with this name.
    StorageError
        If the file cannot be written, or does not read back as written.
    """
    library_path(path)
    with published(path) as part:
        written = 0
        with disk(path, "write"):
            for piece in pieces:
                written = zlib.crc32(piece, written)
                write_whole(part.descriptor, piece)
        with disk(path, "read back"):
            stored = _crc_of(part.path)
        if stored != written:
            raise StorageError(f"{path}: does not read back as written: check the disk")


def _filtered(band: Generic) -> UInt8:
    """Return rows of big-endian samples as bytes, each row after its filter."""
    rows, width, channels = band.shape
    samples = np.ascontiguousarray(band, band.dtype.newbyteorder(">")).view(np.uint8)
    data, pixel = samples.reshape(rows, -1), channels * band.itemsize
    filtered = np.zeros((rows, 1 + width * pixel), np.uint8)
    filtered[:, 0] = _SUB
    filtered[:, 1 : 1 + pixel] = data[:, :pixel]
    np.subtract(data[:, pixel:], data[:, :-pixel], out=filtered[:, 1 + pixel :])
    return filtered


def _crc_of(path: Path) -> int:
    crc = 0
    with os.fdopen(open_binary(path, os.O_RDONLY), "rb", 0) as file:
        while part := file.read(_PART):
            crc = zlib.crc32(part, crc)
    return crc
