"""TIFF and EXR files that are encoded and checked in bands of rows.

The encoder writes into a scratch file, from which the bytes are copied like those of all other
files; then the file is decoded again. Bands keep the memory far below that of the image, and the
same bytes result as from the whole image.
"""

from __future__ import annotations

import errno
import math
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its own name for itself

from acquisition._errors import DataError, StorageError
from acquisition.files.map_rows import MapRows
from acquisition.files.storage import disk, library_path, published, write_whole
from acquisition.pixels.image_input import first_line, opened_image
from rig import UnreadableError
from rig.arrays import Generic
from rig.files import convert_parser_errors

# About the second-level cache. TIFFs have strips of 32 rows, which must not be divided.
_BAND_BYTES = 1 << 20
_STRIP = 32
_PART = 1 << 20
# Larger files are on the disk.
_IN_MEMORY = 128 << 20


def store_image(path: Path, kind: str, spec: oiio.ImageSpec, pixels: MapRows) -> None:
    """Write an image and check that the file holds its pixels.

    The file appears complete and checked, or not at all.

    Parameters
    ----------
    path
        File to write. It must be a name that `read_image` can open.
    kind
        OpenImageIO's name of the format.
    spec
        Size, sample type and attributes.
    pixels
        ``(H, W)`` or ``(H, W, channels)``, of which rows are read band by band.

    Raises
    ------
    DataError
        If `read_image` could not open a file with this name.
    StorageError
        If the encoder fails, or the file cannot be written or does not read back as written.
    """
    library_path(path)
    file = oiio.ImageOutput.create(kind)
    if file is None:
        raise StorageError(
            f"{path}: this OpenImageIO has no writer for {kind}: install another build"
        )
    with ExitStack() as kept:
        with disk(path, "encode"):
            place = kept.enter_context(scratch_file(_nbytes(pixels), path.parent))
            done = file.open(str(place), spec)
            for rows in _bands(pixels):
                # OpenImageIO writes wrong pixels from arrays of two dimensions.
                band = _native(pixels[rows]).reshape(-1, *_shape(pixels)[1:])
                done = done and file.write_scanlines(rows.start, rows.stop, 0, band)
            message = file.geterror()
            # Closing a correct TIFF may leave a message about Exif: only the return values count.
            if not (file.close() and done):
                _check_space(path, pixels)
                raise StorageError(
                    f"{path}: cannot be encoded ({first_line(message)}): free memory on this "
                    "computer, or raise its limit on file sizes"
                )
            encoded = kept.enter_context(place.open("rb"))
        part = kept.enter_context(published(path))
        with disk(path, "write"):
            while piece := encoded.read(_PART):
                write_whole(part.descriptor, piece)
        if not holds(part.path, pixels):
            with disk(path, "write"):
                _check_space(path, pixels)
            raise StorageError(f"{path}: does not read back as written: check the disk")


def holds(path: Path, pixels: MapRows) -> bool:
    """Return whether a file that was just written reads back as these pixels."""
    try:
        with opened_image(path, math.prod(pixels.shape[:2])) as (file, spec, channels, dtype, *_):
            stored = spec.height, spec.width, len(channels)
            if np.dtype(dtype) != pixels.dtype.newbyteorder("=") or stored != _shape(pixels):
                return False
            for rows in _bands(pixels):
                with convert_parser_errors("cut short or damaged"):
                    band = file.read_scanlines(
                        rows.start, rows.stop, 0, 0, spec.nchannels, spec.format.basetype
                    )
                if band is None:
                    return False
                colours = band if channels == list(range(band.shape[2])) else band[..., channels]
                if not _same_bits(colours, _native(pixels[rows])):
                    return False
            # A truncated file may give pixels: only the message shows it.
            return not file.geterror()
    except (DataError, UnreadableError):
        return False


def _bands(pixels: MapRows) -> Iterator[slice]:
    """Yield the rows of an image in bands."""
    height = pixels.shape[0]
    strips = _BAND_BYTES // (_STRIP * (_nbytes(pixels) // height))
    step = _STRIP * max(1, strips)
    for top in range(0, height, step):
        yield slice(top, min(top + step, height))


def _nbytes(pixels: MapRows) -> int:
    return math.prod(pixels.shape) * pixels.dtype.itemsize


def _shape(pixels: MapRows) -> tuple[int, int, int]:
    return pixels.shape[0], pixels.shape[1], math.prod(pixels.shape[2:])


def _native(band: Generic) -> Generic:
    # OpenImageIO writes wrong pixels, without an error, from strided or byte-swapped arrays.
    return np.ascontiguousarray(band, band.dtype.newbyteorder("="))


def _check_space(path: Path, pixels: MapRows) -> None:
    """Raise the error of a full disk, which the encoders do not report."""
    if shutil.disk_usage(path.parent).free < _nbytes(pixels):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


def _same_bits(stored: Generic, pixels: Generic) -> bool:
    # Bits, because NaN is not equal to itself.
    bits = f"u{pixels.itemsize}"
    one, other = (np.ascontiguousarray(part).view(bits).ravel() for part in (stored, pixels))
    return np.array_equal(one, other)


@contextmanager
def scratch_file(size: int, folder: Path) -> Iterator[Path]:
    """Yield the name of a new file that no other process can name, and remove it afterwards.

    On Linux the file is in memory, or in ``folder`` without a name if it may have more than 128 MB,
    so that a killed process leaves nothing behind. On other systems it is in a private temporary
    folder.
    """
    if sys.platform == "linux" and size > _IN_MEMORY:
        with tempfile.TemporaryFile(dir=folder) as file:
            yield Path(f"/proc/self/fd/{file.fileno()}")
    elif sys.platform == "linux":
        descriptor = os.memfd_create("image", os.MFD_CLOEXEC)
        try:
            yield Path(f"/proc/self/fd/{descriptor}")
        finally:
            os.close(descriptor)
    else:
        with tempfile.TemporaryDirectory(prefix="sgp-") as folder:
            yield Path(folder) / "image"
