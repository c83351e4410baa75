"""Image files as arrays: one reader for every format, and writers for TIFF, PNG and EXR.

OpenImageIO does the work. Its errors are return values, its defaults rescale pixels, multiply by
alpha and invent a date; this module is the only place that has to know.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt
import OpenImageIO as oiio  # noqa: N813 - its own name for itself

from acquisition._errors import DataError, MissingPathError, StorageError
from acquisition._pixels.png_chunks import SIGNATURE, check_png
from acquisition._pixels.raw import is_raw
from acquisition._pixels.scratch import scratch_file
from acquisition._storage import disk, library_path, published, write_whole

Image = npt.NDArray[np.uint8] | npt.NDArray[np.uint16] | npt.NDArray[np.float32]

_NATIVE: dict[str, type[np.generic]] = {
    "uint8": np.uint8,
    "uint16": np.uint16,
    "half": np.float32,
    "float": np.float32,
    "double": np.float32,
}
_FILE_TYPES = {"uint8": oiio.UINT8, "uint16": oiio.UINT16, "float32": oiio.FLOAT}


def read_image(path: str | Path) -> Image:
    """Read an image in its own sample type, without any gamma, scaling or rotation.

    Parameters
    ----------
    path
        TIFF, PNG, TGA, EXR, JPEG, BMP, HDR or anything else OpenImageIO decodes. Camera RAW is
        for `read_raw`.

    Returns
    -------
    Image
        ``(H, W)`` for one channel, ``(H, W, 3)`` for RGB; contiguous. uint8 and uint16 as stored
        (fewer bits are stretched to the next of the two), floats as float32. Alpha is dropped and
        colours are not multiplied by it; palettes are resolved.

    Raises
    ------
    MissingPathError
        If there is no such file.
    DataError
        If it is a folder, empty, not an image, cut short or damaged, or holds samples or channels
        that are not the above.
    """
    return read_image_with_alpha(path)[0]


def read_image_with_alpha(path: str | Path) -> tuple[Image, Image | None]:
    """Read an image as `read_image` does, and its alpha beside it.

    Returns
    -------
    tuple[Image, Image | None]
        What `read_image` returns, and alpha ``(H, W)`` of the same type, or None where there is
        none. Both are as stored: whether the file's colours are multiplied by alpha is not known.
    """
    path = Path(path)
    _check_png_file(path)
    with _opened(path) as (file, channels, dtype):
        spec = file.spec()
        pixels = file.read_image(0, 0, 0, spec.nchannels, spec.format.basetype)
        alpha_channel = spec.alpha_channel
        # JPEG returns pixels from a file cut short, and only the message tells.
        message = file.geterror()
    if pixels is None or message:
        raise DataError(f"{path}: cut short or damaged ({_line(message)}): copy it again")
    pixels = pixels.astype(dtype, copy=False)
    alpha = None if alpha_channel < 0 else np.ascontiguousarray(pixels[..., alpha_channel])
    if channels != list(range(pixels.shape[2])):  # picking copies, and most files need none
        pixels = pixels[..., channels]
    return np.ascontiguousarray(pixels[..., 0] if len(channels) == 1 else pixels), alpha


def image_form(path: str | Path) -> tuple[tuple[int, ...], np.dtype[np.generic]]:
    """Return the shape and sample type that `read_image` would give, from the header alone.

    Errors are those of `read_image`, but for damage behind the header.
    """
    with _opened(Path(path)) as (file, channels, dtype):
        size = (file.spec().height, file.spec().width)
    return (size if len(channels) == 1 else (*size, 3)), np.dtype(dtype)


def write_tiff(path: str | Path, pixels: npt.NDArray[np.uint8] | npt.NDArray[np.uint16]) -> None:
    """Write an uncompressed TIFF; equal pixels give equal bytes.

    Parameters
    ----------
    path
        File to create or replace. It appears whole or not at all.
    pixels
        ``(H, W)`` or ``(H, W, 3)`` RGB, uint8 or uint16, stored as they are.

    Raises
    ------
    StorageError
        If the folder does not exist or the disk refuses the write.
    DataError
        If the array has another shape or type.
    """
    _write(Path(path), pixels, "tiff", {"uint8", "uint16"}, "none")


def write_png(path: str | Path, pixels: npt.NDArray[np.uint8] | npt.NDArray[np.uint16]) -> None:
    """Write a PNG. Parameters and errors are those of `write_tiff`."""
    _write(Path(path), pixels, "png", {"uint8", "uint16"}, "zip")


def write_exr(path: str | Path, array: npt.NDArray[np.float32]) -> None:
    """Write a float32 EXR ``(H, W)`` or ``(H, W, 3)``, lossless, NaN and infinity kept.

    Errors are those of `write_tiff`.
    """
    _write(Path(path), array, "openexr", {"float32"}, "zip")


@contextmanager
def _opened(path: Path) -> Iterator[tuple[oiio.ImageInput, list[int], type[np.generic]]]:
    """Open an image that is understood; give it, its colour channels and the type they get."""
    if not path.exists():
        raise MissingPathError(f"{path}: no such file")
    if path.is_dir():
        raise DataError(f"{path}: a folder, not an image file")
    if not path.is_file():  # a pipe or a device, which may never end
        raise DataError(f"{path}: not a regular file: put the image itself there")
    if is_raw(path):
        raise DataError(f"{path}: camera RAW has no picture of its own: read it as RAW")
    hints = oiio.ImageSpec()
    hints.attribute("oiio:UnassociatedAlpha", 1)
    file = oiio.ImageInput.open(library_path(path), hints)
    if file is None:
        raise DataError(f"{path}: not a readable image ({_line(oiio.geterror())})")
    try:
        spec = file.spec()
        sample = str(spec.format)
        if sample not in _NATIVE or spec.deep or spec.depth > 1:
            raise DataError(
                f"{path}: samples of type {sample} are not understood: save it as 8 or 16 bit "
                "unsigned, or float"
            )
        yield file, _colour_channels(spec, path), _NATIVE[sample]
    finally:
        file.close()


def _check_png_file(path: Path) -> None:
    if not path.is_file():
        return
    try:
        with path.open("rb") as file:
            data = file.read(len(SIGNATURE))
            if data == SIGNATURE:
                check_png(data + file.read(), str(path))
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}): check the file") from error


def _colour_channels(spec: oiio.ImageSpec, path: Path) -> list[int]:
    names = list(spec.channelnames)
    if {"R", "G", "B"} <= set(names):
        return [names.index(name) for name in "RGB"]
    colours = [i for i in range(len(names)) if i != spec.alpha_channel]
    if len(colours) not in (1, 3):
        raise DataError(
            f"{path}: channels {', '.join(names)} are not understood: save it as grey or RGB"
        )
    return colours


def _write(
    path: Path, pixels: npt.NDArray[np.generic], kind: str, allowed: set[str], compression: str
) -> None:
    array = np.asarray(pixels)
    if array.dtype.name not in allowed:
        wanted = " or ".join(sorted(allowed))
        raise DataError(f"{path}: {array.dtype} samples cannot be written here: give {wanted}")
    if array.ndim not in (2, 3) or (array.ndim == 3 and array.shape[2] != 3) or not array.size:
        raise DataError(f"{path}: an array of shape {array.shape} is not an image")
    # A 2-D, strided or byte-swapped array would be written with wrong pixels and no error.
    array = array.reshape(*array.shape[:2], -1)
    array = np.ascontiguousarray(array, array.dtype.newbyteorder("="))
    height, width, channels = array.shape
    spec = oiio.ImageSpec(width, height, channels, _FILE_TYPES[array.dtype.name])
    spec.attribute("compression", compression)
    spec.attribute("png:compressionLevel", 1)  # half the time of the default, the same size
    spec.attribute("DateTime", "")  # otherwise the clock goes into the file
    store_image(path, encode_image(path, kind, spec, array), array)


def encode_image(
    path: Path, kind: str, spec: oiio.ImageSpec, array: npt.NDArray[np.generic]
) -> bytes:
    """Return an image as the bytes of a file; of ``path`` is only told.

    Parameters
    ----------
    path
        Where the image will lie, for messages.
    kind
        OpenImageIO's name of the format.
    spec
        Size, sample type and attributes.
    array
        ``(H, W, channels)``, contiguous, in native byte order.

    Raises
    ------
    DataError
        If `read_image` could not open a file of that name.
    StorageError
        If the encoder fails.
    """
    library_path(path)
    file = oiio.ImageOutput.create(kind)
    if file is None:
        raise StorageError(f"{path}: no writer for {kind} in this OpenImageIO: install another")
    with disk(path, "encode"), scratch_file() as place:
        done = file.open(str(place), spec)
        done = done and file.write_image(array)
        message = file.geterror()
        # After close a TIFF that is right may leave a message about Exif: only the results count.
        if not (file.close() and done):
            raise StorageError(
                f"{path}: cannot be encoded ({_line(message)}): free memory of this computer, or "
                "raise its limit on file sizes"
            )
        return place.read_bytes()


def store_image(path: Path, data: bytes, pixels: npt.NDArray[np.generic]) -> None:
    """Write an encoded image; it appears whole and checked to hold these pixels, or not at all.

    Raises
    ------
    DataError
        If `read_image` could not open a file of that name.
    StorageError
        If the disk refuses, or the file does not read back as written.
    """
    library_path(path)
    with published(path) as part:
        with disk(path, "write"):
            write_whole(part.descriptor, data)
        if not holds(part.path, pixels):
            raise StorageError(f"{path}: does not read back as written: check the disk")


def holds(path: Path, pixels: npt.NDArray[np.generic]) -> bool:
    """Tell whether a file that was just written gives these pixels."""
    try:
        stored = read_image(path)
    except (DataError, MissingPathError):
        return False
    # As bytes, because NaN equals nothing.
    return stored.dtype == pixels.dtype and stored.tobytes() == pixels.tobytes()


def _line(message: str) -> str:
    lines = message.splitlines()
    return lines[0].strip() if lines else "no reason given"
