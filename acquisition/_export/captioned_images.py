"""Images for other programs: marked as linear, with the caption in their metadata."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenImageIO as oiio  # noqa: N813 - its own name for itself

from acquisition._export.caption import Caption
from acquisition._pixels.encoded_image import encoded_image, store_image
from acquisition._pixels.png_file import SRGB_CHUNKS, chunk, png_pieces, store_png
from acquisition._values.transfer_curve import LINEAR, TransferCurve


def write_captioned_png(
    path: Path, pixels: npt.NDArray[np.uint16], caption: Caption, transfer: TransferCurve = LINEAR
) -> None:
    """Write a 16-bit PNG with its gamma in its header and the caption as iTXt fields and XMP.

    Parameters
    ----------
    path
        File to create or replace; it appears complete or not at all.
    pixels
        ``(H, W)`` or ``(H, W, 3)`` RGB uint16, stored unchanged.
    caption
        Texts to store in the file.
    transfer
        Transfer curve of the samples. The header cannot state a table.

    Raises
    ------
    StorageError
        If the file cannot be written, or does not read back as written.
    """
    chunks = _curve_chunks(transfer)
    fields = {**caption.texts(), "XML:com.adobe.xmp": caption.xmp()}
    chunks += [chunk(b"iTXt", _international(*field)) for field in fields.items()]
    store_png(path, png_pieces(pixels, chunks=chunks))


def write_captioned_exr(
    path: Path,
    pixels: npt.NDArray[np.float32],
    caption: Caption,
    attributes: dict[str, Any],
    transfer: TransferCurve = LINEAR,
) -> None:
    """Write a lossless float EXR with the caption and further attributes in its header.

    Parameters
    ----------
    path
        File to create or replace; it appears complete or not at all.
    pixels
        ``(H, W)`` or ``(H, W, 3)`` float32.
    caption
        Texts to store in the file.
    attributes
        Texts, numbers or tuples of three numbers by attribute name.
    transfer
        Transfer curve of the samples.

    Raises
    ------
    StorageError
        If the file cannot be written, or does not read back as written.
    """
    image = np.ascontiguousarray(pixels.reshape(*pixels.shape[:2], -1))
    height, width, channels = image.shape
    spec = oiio.ImageSpec(width, height, channels, oiio.FLOAT)
    spec.attribute("compression", "zip")
    if transfer == LINEAR:
        spec.attribute("oiio:ColorSpace", "linear")
    standard = {
        "DocumentName": caption.title,
        "Artist": caption.creator,
        "ImageDescription": caption.description,
        "Copyright": caption.rights,
        "DateTime": f"{caption.taken:%Y:%m:%d %H:%M:%S}",
        "Software": caption.software,
        "Location": caption.place,
        "XMP": caption.xmp(),
    }
    for name, value in {**standard, **attributes}.items():
        if isinstance(value, tuple):
            spec.attribute(name, oiio.TypeDesc("float[3]"), value)
        elif value not in ("", None):
            spec.attribute(name, value)
    if caption.exposure_us is not None:
        spec.attribute("ExposureTime", caption.exposure_us / 1e6)
    with encoded_image(path, "openexr", spec, image) as data:
        store_image(path, data, pixels)


def _curve_chunks(transfer: TransferCurve) -> list[bytes]:
    """Return the chunks that state a transfer curve: PNG 3, 11.3.2.2 and 11.3.2.5."""
    match transfer.kind:
        case "table":
            return []
        case "srgb":
            return list(SRGB_CHUNKS)
    return [chunk(b"gAMA", _gamma(transfer.exponent or 1.0))]


def _gamma(exponent: float) -> bytes:
    return struct.pack(">I", round(100_000 / exponent))


def _international(keyword: str, text: str) -> bytes:
    """Return the data of an uncompressed iTXt chunk without a language tag."""
    clean = text.replace("\0", " ").encode("utf-8", "replace")
    return keyword.encode("latin-1") + b"\0\0\0\0\0" + clean
