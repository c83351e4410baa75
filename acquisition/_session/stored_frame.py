"""The file of a new frame: uncompressed TIFF, written durably and directly from the array."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from acquisition._pixels.plain_rows import plain_tiff_header
from acquisition._storage import disk, published, write_whole

# Size of the pieces, small enough to be hashed while still in the cache.
_PIECE: Final = 1 << 20


@dataclass(frozen=True)
class StoredFrame:
    """Journal entries about the file of a frame.

    Parameters
    ----------
    bytes
        Size of the file.
    file_sha256, pixels_sha256
        Hashes of the file, and of the samples as 16-bit little-endian, row by row from the top,
        channels innermost.
    """

    bytes: int
    file_sha256: str
    pixels_sha256: str


def store_frame(path: Path, pixels: npt.NDArray[np.uint16]) -> StoredFrame:
    """Write a frame under a temporary name, flush it, and rename it.

    The samples are written directly from the array without copies, and the GIL is released during
    writing and hashing. Equal pixels give equal bytes.

    Parameters
    ----------
    path
        An unused path.
    pixels
        ``(H, W)`` or ``(H, W, 3)`` uint16; they are copied once if not contiguous.

    Raises
    ------
    StorageError
        If the disk refuses; ``path`` then does not exist or is the complete frame.
    """
    samples = np.ascontiguousarray(pixels, dtype="<u2").data.cast("B")
    header = plain_tiff_header(pixels.shape, len(samples))
    of_file, of_pixels = hashlib.sha256(header), hashlib.sha256()
    with published(path) as part, disk(path, "write"):
        write_whole(part.descriptor, header)
        for start in range(0, len(samples), _PIECE):
            piece = samples[start : start + _PIECE]
            write_whole(part.descriptor, piece)
            of_file.update(piece)
            of_pixels.update(piece)
    return StoredFrame(len(header) + len(samples), of_file.hexdigest(), of_pixels.hexdigest())
