"""Opening of image files with OpenImageIO, after the checks of `rig`."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its own name for itself

from acquisition._errors import DataError, convert_read_errors
from acquisition.files.storage import library_path
from acquisition.pixels.image_head import check_image_head
from acquisition.pixels.png_file import SIGNATURE, check_png
from acquisition.values.image_names import is_raw
from rig import UnreadableError
from rig.arrays import AnyArray
from rig.files import check_pixels, convert_parser_errors, read_head

_NATIVE: dict[str, type[np.generic]] = {
    "uint8": np.uint8,
    "uint16": np.uint16,
    "half": np.float32,
    "float": np.float32,
    "double": np.float32,
}
# TIFF 6.0, section 8, and DNG 1.6: interpretations whose samples are not light, with the remedy.
_MIN_IS_WHITE: Final = 0
_NO_LIGHT: Final = {
    5: ("CMYK", "save it as RGB"),
    8: ("CIE L*a*b*", "save it as RGB"),
    9: ("ICC L*a*b*", "save it as RGB"),
    10: ("ITU L*a*b*", "save it as RGB"),
    32803: (
        "a colour filter mosaic",
        "give the camera RAW file, with the suffix of its kind, or save it as RGB",
    ),
}
_CODECS: Final = {
    34712: "JPEG 2000", 34887: "LERC", 34925: "LZMA", 34933: "PNG", 34934: "JPEG XR",
    50000: "ZSTD", 50001: "WebP", 50002: "JPEG XL", 52546: "JPEG XL",
}  # fmt: skip
# What the decoders say about files that are intact, but need another decoder.
_NO_DECODER: Final = re.compile(
    r"not configured|not implemented|not compiled|(?i:unsupported (jpeg|marker|sof|data))"
)
# A longer file of pages is no image; looking at each page takes time.
_MOST_PAGES: Final = 64
_REDUCED_OR_MASK: Final = 0b101


class OpenedImage(NamedTuple):
    """An open image.

    Parameters
    ----------
    file, spec
        Its reader and its header.
    channels
        Numbers of the colour channels.
    dtype
        The NumPy sample type.
    page
        Number of the page that is read, from 0.
    parts
        Number of images in the file, if the others are not pages of a TIFF.
    inverted
        Whether the largest sample is black.
    """

    file: oiio.ImageInput
    spec: oiio.ImageSpec
    channels: list[int]
    dtype: type[np.generic]
    page: int = 0
    parts: int = 1
    inverted: bool = False

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape ``(h, w)`` or ``(h, w, 3)`` of the colours."""
        size = (self.spec.height, self.spec.width)
        return size if len(self.channels) == 1 else (*size, 3)

    def colours(self, pixels: AnyArray) -> AnyArray:
        """Return the colours ``(h, w)`` or ``(h, w, 3)`` of pixels ``(h, w, channels)``."""
        if len(self.channels) == 1:
            pixels = pixels[..., self.channels[0]]
        elif self.channels != list(range(pixels.shape[2])):  # most files need no copy
            pixels = pixels[..., self.channels]
        pixels = np.ascontiguousarray(pixels)
        return ~pixels if self.inverted else pixels

    def alpha(self, pixels: AnyArray) -> AnyArray | None:
        """Return the alpha ``(h, w)`` of pixels ``(h, w, channels)``; None without alpha."""
        place = self.spec.alpha_channel
        return None if place < 0 else np.ascontiguousarray(pixels[..., place])

    def decoded(self, path: Path, read: Callable[..., Any], *place: int) -> AnyArray:
        """Return all channels that a method of the reader decodes at a place, in `dtype`."""
        with (
            convert_read_errors(path),
            convert_parser_errors("cut short or damaged, copy it again"),
        ):
            pixels = read(*place, self.spec.nchannels, self.spec.format.basetype)
            # JPEG returns pixels from a truncated file; only the message shows it.
            message = self.file.geterror()
        if pixels is None or message:
            raise self.undecodable(path, message)
        # Doubles beyond the range of float32 become infinite; callers handle infinity.
        with np.errstate(over="ignore"):
            values: AnyArray = pixels.astype(self.dtype, copy=False)
        return values

    def undecodable(self, path: Path, message: str) -> DataError:
        """Return the error for pixels that cannot be decoded, with OpenImageIO's message."""
        reason = first_line(message)
        if not _NO_DECODER.search(reason):
            return DataError(f"{path}: cut short or damaged ({reason}): copy it again")
        codec = _CODECS.get(self.spec.get_int_attribute("tiff:Compression"))
        if codec is None and "precision" in reason:
            bits = reason.partition("precision ")[2][:2].strip()
            codec = f"{bits}-bit JPEG" if bits == "12" else f"lossless JPEG ({bits} bits)"
        what = f"compressed as {codec}" if codec else f"of a kind ({reason})"
        return DataError(
            f"{path}: {what}, which cannot be decoded here: save it as TIFF without compression or "
            "with LZW, or as PNG"
        )


@contextmanager
def opened_image(path: Path, max_pixels: int) -> Iterator[OpenedImage]:
    """Open an image that `read_image` accepts, as far as its header shows.

    Of the pages of a TIFF, the largest is opened: the others are its thumbnails.

    Raises
    ------
    MissingPathError, DataError
        As `read_image`, except for damage after the header.
    """
    if is_raw(path):
        raise DataError(f"{path}: camera RAW is not an ordinary image: read it as RAW")
    with convert_read_errors(path):
        file_bytes = check_image_head(path, max_pixels)
        file = open_image(path)
    try:
        with convert_read_errors(path), convert_parser_errors("not a readable image"):
            page, parts = _page(file, path)
            spec = file.spec()
            sample, bits = str(spec.format), spec.get_int_attribute("oiio:BitsPerSample")
            photometry = spec.get_int_attribute("tiff:PhotometricInterpretation", -1)
            if spec.get_string_attribute("jpeg:ColorSpace") in ("CMYK", "YCbCrK"):
                photometry = 5
        if photometry in _NO_LIGHT:
            what, remedy = _NO_LIGHT[photometry]
            raise DataError(f"{path}: its samples are {what}, not light: {remedy}")
        if sample not in _NATIVE or spec.deep or spec.depth > 1:
            raise DataError(
                f"{path}: samples of type {sample} are not supported: save the image as 8 or 16 "
                "bit unsigned, or float"
            )
        # OpenImageIO inverts 8 bits itself.
        inverted = photometry == _MIN_IS_WHITE and sample != "uint8"
        if inverted and sample != "uint16":
            raise DataError(
                f"{path}: float samples whose largest is black (MinIsWhite) have no known white: "
                "save the image with black at 0"
            )
        with convert_read_errors(path):
            bits = bits or 8 * spec.format.size()
            check_pixels(spec.width, spec.height, bits * spec.nchannels, file_bytes, max_pixels)
        channels = _colour_channels(spec, path)
        yield OpenedImage(file, spec, channels, _NATIVE[sample], page, parts, inverted)
    finally:
        file.close()


def _page(file: oiio.ImageInput, path: Path) -> tuple[int, int]:
    """Select the page of a TIFF that is the image; return its number, and `OpenedImage.parts`.

    Pages that are marked as reduced or as a mask (TIFF 6.0, NewSubfileType), or are smaller than
    others, do not count.
    """
    if file.format_name() not in ("tiff", "openexr"):
        return 0, 1
    sizes: list[tuple[int, int]] = []
    marked: list[bool] = []
    while len(sizes) <= _MOST_PAGES and file.seek_subimage(len(sizes), 0):
        spec = file.spec()
        sizes.append((spec.width, spec.height))
        marked.append(bool(spec.get_int_attribute("tiff:subfiletype") & _REDUCED_OR_MASK))
    file.geterror()
    if file.format_name() != "tiff":
        file.seek_subimage(0, 0)
        return 0, len(sizes)
    pages = [page for page, reduced in enumerate(marked) if not reduced] or list(range(len(sizes)))
    largest = max((sizes[page] for page in pages), key=math.prod)
    pages = [page for page in pages if sizes[page] == largest]
    if len(pages) > 1:
        raise DataError(
            f"{path}: has {len(pages)} pages of {largest[0]} x {largest[1]} pixels: save the page "
            "that is the image of this light in a file of its own, colours in one page"
        )
    file.seek_subimage(pages[0], 0)
    return pages[0], 1


def spec_attribute(spec: oiio.ImageSpec, name: str) -> Any:
    """Return an attribute of a header, or None if it is missing or no text that can be read."""
    try:
        with convert_parser_errors(name):
            return spec.getattribute(name)
    except UnreadableError:
        return None


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
        raise UnreadableError(f"not a readable image ({first_line(message)}): copy it again")
    return file


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


def check_png_file(path: Path) -> None:
    """Check the chunks of a file if it is a PNG.

    Raises
    ------
    MissingPathError, DataError
        If it is missing, cannot be read, is truncated or damaged.
    """
    with convert_read_errors(path):
        if read_head(path, len(SIGNATURE))[0] != SIGNATURE:
            return
        with convert_parser_errors("cannot be read"), path.open("rb", 1 << 18) as file:
            check_png(file, str(path))


def first_line(message: str) -> str:
    """Return the first line of a message of OpenImageIO."""
    lines = message.splitlines()
    return lines[0].strip() if lines else "no reason given"
