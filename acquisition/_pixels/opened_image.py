"""Opening of image files with OpenImageIO, after the checks of `rig`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its own name for itself

from acquisition._errors import DataError, convert_read_errors
from acquisition._pixels.image_head import check_image_head
from acquisition._pixels.png_chunks import SIGNATURE, check_png
from acquisition._storage import library_path
from acquisition._suffixes import is_raw
from rig import UnreadableError, check_pixels, convert_parser_errors, read_head

_NATIVE: dict[str, type[np.generic]] = {
    "uint8": np.uint8,
    "uint16": np.uint16,
    "half": np.float32,
    "float": np.float32,
    "double": np.float32,
}


class OpenedImage(NamedTuple):
    """An open image: its reader, its spec, its colour channels and the NumPy sample type."""

    file: oiio.ImageInput
    spec: oiio.ImageSpec
    channels: list[int]
    dtype: type[np.generic]


@contextmanager
def opened_image(path: Path, max_pixels: int) -> Iterator[OpenedImage]:
    """Open an image that `read_image` accepts, as far as its header shows.

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
        yield OpenedImage(file, spec, _colour_channels(spec, path), _NATIVE[sample])
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
