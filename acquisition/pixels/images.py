"""Image files as arrays: one reader for every format, and writers for TIFF, PNG and EXR.

This module wraps OpenImageIO, which reports errors as return values and by default rescales
pixels, multiplies by alpha and adds the current date. No other module has to handle that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its own name for itself

from acquisition._errors import DataError
from acquisition.files.map_rows import ComputedRows, MapRows, rows_of
from acquisition.pixels.encoded_image import store_image
from acquisition.pixels.image_input import OpenedImage, check_png_file, opened_image
from acquisition.pixels.png_file import SRGB_CHUNKS, chunk, png_pieces, store_png
from rig import MAX_PIXELS
from rig.arrays import AnyArray, Bool, Float32, UInt8, UInt16

Image = UInt8 | UInt16 | Float32

# Floats are compressed if they contain more zeros than this; every so many rows are looked at.
_LEAST_ZEROS = 0.02
_SAMPLED_ROWS = 16
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
    >>> from acquisition import write_png
    >>> from acquisition.pixels import read_image_with_alpha
    >>> write_png("card.png", np.full((4, 5), 700, np.uint16), alpha=np.eye(4, 5, dtype=bool))
    >>> image, alpha = read_image_with_alpha("card.png")
    >>> alpha[0]
    array([65535,     0,     0,     0,     0], dtype=uint16)
    """
    path = Path(path)
    with opened_image(path, max_pixels) as image:
        pixels = _decoded(path, image)
    return image.colours(pixels), image.alpha(pixels)


def read_frame(path: Path, shape: tuple[int, ...]) -> UInt16:
    """Read the pixels of a recorded frame, uint16 of a shape.

    Raises
    ------
    MissingPathError, DataError
        As `read_image`; or the header states another size or type.
    """
    with opened_image(path, max(shape[0] * shape[1], MAX_PIXELS)) as image:
        if image.shape != shape or image.dtype != np.uint16:
            raise DataError(
                f"{path}: has {np.dtype(image.dtype)} pixels of shape {image.shape}, the session "
                f"requires uint16 of {shape}; restore the file"
            )
        pixels = image.colours(_decoded(path, image))
    return pixels.astype(np.uint16, copy=False)


def _decoded(path: Path, image: OpenedImage) -> Image:
    # After the header check, which is faster and may refuse the file.
    check_png_file(path)
    return image.decoded(path, image.file.read_image, image.page, 0, 0)


def write_tiff(path: str | Path, pixels: UInt8 | UInt16) -> None:
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
    >>> from acquisition import read_image
    >>> from acquisition.pixels import write_tiff
    >>> write_tiff("card.tif", np.full((4, 5), 700, np.uint16))
    >>> int(read_image("card.tif")[0, 0])
    700
    """
    path, array = Path(path), rows_of(pixels)
    _check(path, array, {"uint8", "uint16"})
    write_with_attributes(path, array, "tiff", {"compression": "none"})


def write_png(
    path: str | Path,
    pixels: UInt8 | UInt16 | MapRows,
    *,
    alpha: Bool | MapRows | None = None,
    srgb: bool = False,
    description: str = "",
) -> None:
    """Write a PNG; equal arguments give equal bytes.

    Parameters
    ----------
    path, pixels
        As in `write_tiff`, as are the errors; or a map whose rows are read band by band.
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
    path = Path(path)
    array = rows_of(pixels)
    _check(path, array, {"uint8", "uint16"})
    opacity = None if alpha is None else _opacity(path, rows_of(alpha), array)
    chunks = list(SRGB_CHUNKS) if srgb else []
    if description:
        chunks.append(chunk(b"tEXt", b"Description\0" + description.encode("latin-1", "replace")))
    store_png(path, png_pieces(array, opacity, chunks))


def write_exr(path: str | Path, array: Float32 | MapRows) -> None:
    """Write a lossless float32 EXR ``(H, W)`` or ``(H, W, 3)``; NaN and infinity are kept.

    Errors are those of `write_tiff`. The rows of a map on disk are read band by band.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import read_image, write_exr
    >>> write_exr("height.exr", np.array([[0.5, np.nan]], np.float32))
    >>> read_image("height.exr")
    array([[0.5, nan]], dtype=float32)
    """
    path, values = Path(path), rows_of(array)
    _check(path, values, {"float32"})
    compression = "rle" if _has_zeros(values) else "none"
    write_with_attributes(path, values, "openexr", {"compression": compression})


def _has_zeros(values: MapRows) -> bool:
    """Return whether zeros, as outside a mask, are frequent.

    The run lengths of EXR shorten nothing else, not even NaN, and take more time than the rest.
    """
    sampled = [values[row : row + 1] == 0 for row in range(0, values.shape[0], _SAMPLED_ROWS)]
    return not sampled or bool(np.mean([row.mean() for row in sampled]) > _LEAST_ZEROS)


def write_with_attributes(
    path: Path, array: MapRows, kind: str, attributes: Mapping[str, Any]
) -> None:
    """Write an image of a format of OpenImageIO with attributes in its header.

    Parameters
    ----------
    path
        As in `write_tiff`, as are the errors.
    array
        ``(H, W)`` or ``(H, W, 3)`` RGB of a type that the format can hold.
    kind
        OpenImageIO's name of the format.
    attributes
        Texts, numbers or tuples of three numbers by name; an empty text or None is left out.
    """
    height, width = array.shape[:2]
    channels = math.prod(array.shape[2:])
    spec = oiio.ImageSpec(width, height, channels, _FILE_TYPES[array.dtype.name])
    spec.attribute("DateTime", "")  # otherwise the current time is written
    for name, value in attributes.items():
        if isinstance(value, tuple):
            spec.attribute(name, oiio.TypeDesc("float[3]"), value)
        elif value not in ("", None):
            spec.attribute(name, value)
    store_image(path, kind, spec, array)


def _check(path: Path, array: MapRows, allowed: set[str]) -> None:
    if array.dtype.name not in allowed:
        types = " or ".join(sorted(allowed))
        raise DataError(f"{path}: {array.dtype} samples cannot be written here: give {types}")
    shape = array.shape
    if len(shape) not in (2, 3) or (len(shape) == 3 and shape[2] != 3) or not math.prod(shape):
        raise DataError(f"{path}: an array of shape {shape} is not an image")


def _opacity(path: Path, alpha: MapRows, array: MapRows) -> MapRows:
    if alpha.dtype != np.bool_ or alpha.shape != array.shape[:2]:
        raise DataError(
            f"{path}: an alpha channel of {alpha.dtype} and shape {alpha.shape} does not fit an "
            f"image of shape {array.shape[:2]}"
        )
    kind = array.dtype.newbyteorder("=")
    full = kind.type(np.iinfo(kind).max)
    return ComputedRows(alpha.shape, kind, lambda rows: alpha[rows].astype(kind) * full)


class ImageRows:
    """An image as `read_image` returns it, of which only the rows in use are in memory.

    Read from the top downwards: a compressed file is decoded again from its start otherwise.

    Parameters
    ----------
    path
        As in `read_image`, as are the errors; damage shows when its rows are read.
    max_pixels
        Largest allowed number of pixels.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import write_png
    >>> from acquisition.pixels import ImageRows
    >>> write_png("ramp.png", np.arange(20, dtype=np.uint16).reshape(5, 4))
    >>> with ImageRows("ramp.png") as rows:
    ...     rows.shape, rows[1:3]
    ((5, 4), array([[ 4,  5,  6,  7],
           [ 8,  9, 10, 11]], dtype=uint16))
    """

    def __init__(self, path: str | Path, *, max_pixels: int = MAX_PIXELS) -> None:
        self.path = Path(path)
        with ExitStack() as opened:
            self._image = opened.enter_context(opened_image(self.path, max_pixels))
            check_png_file(self.path)
            self._opened = opened.pop_all()
        self.shape = self._image.shape
        self.dtype = np.dtype(self._image.dtype)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: slice) -> AnyArray:
        return self._image.colours(self._read(rows))

    def with_alpha(self, rows: slice) -> tuple[AnyArray, AnyArray | None]:
        """Return rows as `read_image_with_alpha` does: the colours, and alpha or None."""
        band = self._read(rows)
        return self._image.colours(band), self._image.alpha(band)

    def _read(self, rows: slice) -> AnyArray:
        """Return rows ``(h, W, channels)`` of all channels of the file."""
        first, last, _ = rows.indices(self.shape[0])
        image, top = self._image, self._image.spec.y
        band = image.decoded(self.path, image.file.read_scanlines, top + first, top + last, 0, 0)
        pixels: AnyArray = band.reshape(last - first, self.shape[1], image.spec.nchannels)
        return pixels

    @property
    def size(self) -> int:
        """Number of values."""
        return math.prod(self.shape)

    def close(self) -> None:
        """Close the file; harmless if repeated."""
        self._opened.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
