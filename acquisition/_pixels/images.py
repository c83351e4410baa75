"""Image files as arrays: one reader for every format, and writers for TIFF, PNG and EXR.

This module wraps OpenImageIO, which reports errors as return values and by default rescales
pixels, multiplies by alpha and adds the current date. No other module has to handle that.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenImageIO as oiio  # noqa: N813 - its own name for itself

from acquisition._errors import DataError, StorageError, convert_read_errors
from acquisition._pixels.image_head import check_image_head
from acquisition._pixels.png_chunks import SIGNATURE, check_png
from acquisition._pixels.raw import is_raw
from acquisition._pixels.scratch import scratch_file
from acquisition._pixels.stated_curve import StatedCurve, stated_curve
from acquisition._storage import disk, library_path, published, write_whole
from rig import (
    MAX_BINARY_BYTES,
    MAX_PIXELS,
    UnreadableError,
    check_pixels,
    convert_parser_errors,
    read_bounded,
    read_head,
)

Image = npt.NDArray[np.uint8] | npt.NDArray[np.uint16] | npt.NDArray[np.float32]

_NATIVE: dict[str, type[np.generic]] = {
    "uint8": np.uint8,
    "uint16": np.uint16,
    "half": np.float32,
    "float": np.float32,
    "double": np.float32,
}
_PNG_FILTER_SUB = 16
_FILE_TYPES = {"uint8": oiio.UINT8, "uint16": oiio.UINT16, "float32": oiio.FLOAT}


def read_image(path: str | Path, *, max_pixels: int = MAX_PIXELS) -> Image:
    """Read an image in its own sample type, without gamma correction, scaling or rotation.

    Parameters
    ----------
    path
        TIFF, PNG, TGA, EXR, JPEG, BMP, HDR, DPX, JPEG 2000, JPEG XL, WebP or PNM. For camera RAW
        use `read_raw`.
    max_pixels
        Largest allowed number of pixels, checked before anything is decoded.

    Returns
    -------
    Image
        ``(H, W)`` for one channel, ``(H, W, 3)`` for RGB; contiguous. uint8 and uint16 as stored
        (samples with fewer bits are scaled to the next of the two), floats as float32. Alpha is
        dropped and colours are not multiplied by it; palettes are resolved.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If the file is a folder, empty, not an image, truncated or damaged, has more than
        ``max_pixels`` pixels or far more than a file of its size can hold, or has other sample
        types or channels than those above.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import read_image, write_png
    >>> write_png("card.png", np.full((4, 5), 700, np.uint16))
    >>> image = read_image("card.png")
    >>> image.dtype, image.shape
    (dtype('uint16'), (4, 5))
    """
    return read_image_with_alpha(path, max_pixels=max_pixels)[0]


def read_image_with_alpha(
    path: str | Path, *, max_pixels: int = MAX_PIXELS
) -> tuple[Image, Image | None]:
    """Read an image as `read_image` does, together with its alpha channel.

    Returns
    -------
    tuple[Image, Image | None]
        The image that `read_image` returns, and alpha ``(H, W)`` of the same type, or None if the
        file has no alpha. Both are as stored; the file does not state whether its colours are
        multiplied by alpha.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import read_image_with_alpha, write_png
    >>> write_png("card.png", np.full((4, 5), 700, np.uint16), alpha=np.eye(4, 5, dtype=bool))
    >>> image, alpha = read_image_with_alpha("card.png")
    >>> alpha[0]
    array([65535,     0,     0,     0,     0], dtype=uint16)
    """
    path = Path(path)
    with _opened(path, max_pixels) as (file, spec, channels, dtype):
        # After the header check, which is faster and may refuse the file.
        _check_png_file(path)
        with (
            convert_read_errors(path),
            convert_parser_errors("cut short or damaged, copy it again"),
        ):
            pixels = file.read_image(0, 0, 0, spec.nchannels, spec.format.basetype)
            # JPEG returns pixels from a truncated file; only the message shows it.
            message = file.geterror()
    if pixels is None or message:
        raise DataError(f"{path}: cut short or damaged ({_line(message)}): copy it again")
    pixels = _as_type(pixels, dtype)
    alpha_channel = spec.alpha_channel
    alpha = None if alpha_channel < 0 else np.ascontiguousarray(pixels[..., alpha_channel])
    if channels != list(range(pixels.shape[2])):  # most files need no copy
        pixels = pixels[..., channels]
    return np.ascontiguousarray(pixels[..., 0] if len(channels) == 1 else pixels), alpha


@dataclass(frozen=True)
class ImageForm:
    """What the header of an image states.

    Parameters
    ----------
    shape, dtype
        Shape and sample type of the array that `read_image` returns.
    transfer
        The transfer curve of the samples.
    alpha
        Whether the file has an alpha channel.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[np.generic]
    transfer: StatedCurve
    alpha: bool = False


def image_form(path: str | Path, *, max_pixels: int = MAX_PIXELS) -> ImageForm:
    """Return the form of the image that `read_image` would return, from the header only.

    Errors are those of `read_image`, except for damage after the header.
    """
    path = Path(path)
    with _opened(path, max_pixels) as (file, spec, channels, dtype):
        size = (spec.height, spec.width)
        with convert_read_errors(path):
            transfer = stated_curve(path, file.format_name(), spec)
    shape = size if len(channels) == 1 else (*size, 3)
    return ImageForm(shape, np.dtype(dtype), transfer, spec.alpha_channel >= 0)


def write_tiff(path: str | Path, pixels: npt.NDArray[np.uint8] | npt.NDArray[np.uint16]) -> None:
    """Write an uncompressed TIFF; equal pixels give equal bytes.

    Parameters
    ----------
    path
        File to create or replace. It appears complete or not at all.
    pixels
        ``(H, W)`` or ``(H, W, 3)`` RGB, uint8 or uint16, stored unchanged.

    Raises
    ------
    StorageError
        If the folder does not exist or the file cannot be written.
    DataError
        If the array has another shape or type.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import read_image, write_tiff
    >>> write_tiff("card.tif", np.full((4, 5), 700, np.uint16))
    >>> int(read_image("card.tif")[0, 0])
    700
    """
    _write(Path(path), pixels, "tiff", {"uint8", "uint16"}, {"compression": "none"})


def write_png(
    path: str | Path,
    pixels: npt.NDArray[np.uint8] | npt.NDArray[np.uint16],
    *,
    alpha: npt.NDArray[np.bool_] | None = None,
    srgb: bool = False,
    description: str = "",
) -> None:
    """Write a PNG; equal arguments give equal bytes.

    Parameters
    ----------
    path, pixels
        As in `write_tiff`, as are the errors.
    alpha
        ``(H, W)`` bool, True where the image is opaque; the colours are not multiplied by it.
        Default: no alpha channel.
    srgb
        State in the file that the samples follow the sRGB curve; otherwise it states no curve.
    description
        Text of the file, stored under the keyword ``Description``.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import read_image, write_png
    >>> write_png("red.png", np.full((4, 5, 3), (255, 0, 0), np.uint8), srgb=True)
    >>> read_image("red.png")[0, 0]
    array([255,   0,   0], dtype=uint8)
    """
    attributes = {"compression": "rle", "oiio:ColorSpace": "sRGB" if srgb else "data"}
    if description:
        attributes["ImageDescription"] = description
    _write(Path(path), pixels, "png", {"uint8", "uint16"}, attributes, alpha)


def write_exr(path: str | Path, array: npt.NDArray[np.float32]) -> None:
    """Write a lossless float32 EXR ``(H, W)`` or ``(H, W, 3)``; NaN and infinity are kept.

    Errors are those of `write_tiff`.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import read_image, write_exr
    >>> write_exr("height.exr", np.array([[0.5, np.nan]], np.float32))
    >>> read_image("height.exr")
    array([[0.5, nan]], dtype=float32)
    """
    _write(Path(path), array, "openexr", {"float32"}, {"compression": "rle"})


@contextmanager
def _opened(
    path: Path, max_pixels: int
) -> Iterator[tuple[oiio.ImageInput, oiio.ImageSpec, list[int], type[np.generic]]]:
    """Open an image; yield its reader, its spec, its colour channels and the NumPy sample type."""
    if is_raw(path):
        raise DataError(f"{path}: camera RAW is not an ordinary image: read it as RAW")
    with convert_read_errors(path):
        file_bytes = check_image_head(path, max_pixels)
        file = open_image(path)
    try:
        with convert_read_errors(path), convert_parser_errors("not a readable image"):
            spec = file.spec()
            sample, bits = str(spec.format), spec.get_int_attribute("oiio:BitsPerSample")
        if sample not in _NATIVE or spec.deep or spec.depth > 1:
            raise DataError(
                f"{path}: samples of type {sample} are not supported: save the image as 8 or 16 "
                "bit unsigned, or float"
            )
        with convert_read_errors(path):
            bits = bits or 8 * spec.format.size()
            check_pixels(spec.width, spec.height, bits * spec.nchannels, file_bytes, max_pixels)
        yield file, spec, _colour_channels(spec, path), _NATIVE[sample]
    finally:
        file.close()


def open_image(path: Path) -> oiio.ImageInput:
    """Open an image after `check_image_head`.

    Raises
    ------
    UnreadableError
        If OpenImageIO cannot open it.
    """
    hints = oiio.ImageSpec()
    hints.attribute("oiio:UnassociatedAlpha", 1)
    name = library_path(path)
    with convert_parser_errors("not a readable image"):
        file = oiio.ImageInput.open(name, hints)
        message = "" if file is not None else oiio.geterror()
    if file is None:
        raise UnreadableError(f"not a readable image ({_line(message)})")
    return file


def _as_type(pixels: npt.NDArray[Any], dtype: type[np.generic]) -> npt.NDArray[Any]:
    # Doubles beyond the range of float32 become infinite; callers handle infinity.
    with np.errstate(over="ignore"):
        return pixels.astype(dtype, copy=False)


def _check_png_file(path: Path) -> None:
    with convert_read_errors(path):
        if read_head(path, len(SIGNATURE))[0] == SIGNATURE:
            check_png(read_bounded(path, MAX_BINARY_BYTES), str(path))


def _colour_channels(spec: oiio.ImageSpec, path: Path) -> list[int]:
    names = list(spec.channelnames)
    if {"R", "G", "B"} <= set(names):
        return [names.index(name) for name in "RGB"]
    colours = [i for i in range(len(names)) if i != spec.alpha_channel]
    if len(colours) not in (1, 3):
        raise DataError(
            f"{path}: channels {', '.join(names)} are not supported: save the image as grey or RGB"
        )
    return colours


def _write(
    path: Path,
    pixels: npt.NDArray[np.generic],
    kind: str,
    allowed: set[str],
    attributes: dict[str, str],
    alpha: npt.NDArray[np.bool_] | None = None,
) -> None:
    array = np.asarray(pixels)
    if array.dtype.name not in allowed:
        types = " or ".join(sorted(allowed))
        raise DataError(f"{path}: {array.dtype} samples cannot be written here: give {types}")
    if array.ndim not in (2, 3) or (array.ndim == 3 and array.shape[2] != 3) or not array.size:
        raise DataError(f"{path}: an array of shape {array.shape} is not an image")
    opacity = None if alpha is None else _opacity(path, alpha, array)
    # OpenImageIO writes wrong pixels, without an error, from 2-D, strided or byte-swapped arrays.
    array = array.reshape(*array.shape[:2], -1)
    array = np.ascontiguousarray(array, array.dtype.newbyteorder("="))
    stored = array if opacity is None else np.dstack([array, opacity])
    height, width, channels = stored.shape
    spec = oiio.ImageSpec(width, height, channels, _FILE_TYPES[array.dtype.name])
    if opacity is not None and channels == 2:
        spec.channelnames = ("Y", "A")
        spec.alpha_channel = 1
    spec.attribute("oiio:UnassociatedAlpha", 1)
    # Runs of equal bytes after a difference to the left: measured maps become as small as by the
    # search for repeated strings, in a quarter of its time.
    spec.attribute("png:compressionLevel", 1)
    spec.attribute("png:filter", _PNG_FILTER_SUB)
    spec.attribute("DateTime", "")  # otherwise the current time is written
    for name, value in attributes.items():
        spec.attribute(name, value)
    store_image(path, encode_image(path, kind, spec, stored), array, opacity)


def _opacity(
    path: Path, alpha: npt.NDArray[np.bool_], array: npt.NDArray[np.generic]
) -> npt.NDArray[np.generic]:
    if alpha.dtype != np.bool_ or alpha.shape != array.shape[:2]:
        raise DataError(
            f"{path}: an alpha channel of {alpha.dtype} and shape {alpha.shape} does not fit an "
            f"image of shape {array.shape[:2]}"
        )
    opacity: npt.NDArray[np.generic] = alpha * np.iinfo(array.dtype.name).max
    return opacity.astype(array.dtype.newbyteorder("="))


def encode_image(
    path: Path, kind: str, spec: oiio.ImageSpec, array: npt.NDArray[np.generic]
) -> bytes:
    """Encode an image as the bytes of a file.

    Parameters
    ----------
    path
        Path of the future file; nothing is written there. It must be a name that `read_image` can
        open, and messages show it.
    kind
        OpenImageIO's name of the format.
    spec
        Size, sample type and attributes.
    array
        ``(H, W, channels)``, contiguous, in native byte order.

    Raises
    ------
    DataError
        If `read_image` could not open a file with this name.
    StorageError
        If the encoder fails.
    """
    library_path(path)
    file = oiio.ImageOutput.create(kind)
    if file is None:
        raise StorageError(
            f"{path}: this OpenImageIO has no writer for {kind}: install another build"
        )
    with disk(path, "encode"), scratch_file() as place:
        done = file.open(str(place), spec)
        done = done and file.write_image(array)
        message = file.geterror()
        # Closing a correct TIFF may leave a message about Exif: only the return values count.
        if not (file.close() and done):
            raise StorageError(
                f"{path}: cannot be encoded ({_line(message)}): free memory on this computer, or "
                "raise its limit on file sizes"
            )
        return place.read_bytes()


def store_image(
    path: Path,
    data: bytes,
    pixels: npt.NDArray[np.generic],
    alpha: npt.NDArray[np.generic] | None = None,
) -> None:
    """Write an encoded image and check that it holds these pixels and this alpha channel.

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
        with disk(path, "write"):
            write_whole(part.descriptor, data)
        if not holds(part.path, pixels, alpha):
            raise StorageError(f"{path}: does not read back as written: check the disk")


def holds(
    path: Path, pixels: npt.NDArray[np.generic], alpha: npt.NDArray[np.generic] | None = None
) -> bool:
    """Return whether a file that was just written reads back as these pixels and this alpha."""
    try:
        max_pixels = pixels.shape[0] * pixels.shape[1]
        stored, opacity = read_image_with_alpha(path, max_pixels=max_pixels)
    except DataError:
        return False
    if alpha is not None and (opacity is None or opacity.tobytes() != alpha.tobytes()):
        return False
    if stored.dtype != pixels.dtype or stored.size != pixels.size:
        return False
    # Compare bits, because NaN is not equal to itself.
    bits = f"u{pixels.itemsize}"
    return np.array_equal(stored.view(bits).ravel(), pixels.view(bits).ravel())


def _line(message: str) -> str:
    lines = message.splitlines()
    return lines[0].strip() if lines else "no reason given"
