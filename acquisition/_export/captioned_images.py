"""Images for other programs: marked as linear, with the caption in their metadata."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import OpenImageIO as oiio  # noqa: N813 - its own name for itself

from acquisition._errors import StorageError
from acquisition._export.caption import Caption
from acquisition._pixels.encoded_image import encoded_image, store_image
from acquisition._pixels.png_chunks import SIGNATURE
from acquisition._values.transfer_curve import LINEAR, TransferCurve

# Five times as fast as OpenImageIO's PNG writer, and smaller files on sensor noise.
_PNG_OPTIONS = (
    cv2.IMWRITE_PNG_STRATEGY,
    cv2.IMWRITE_PNG_STRATEGY_RLE,
    cv2.IMWRITE_PNG_FILTER,
    cv2.IMWRITE_PNG_FILTER_SUB,
)
_HEADER_END = len(SIGNATURE) + 4 + 4 + 13 + 4  # IHDR: length, kind, 13 bytes, CRC
_RENDERING_INTENT = b"\1"  # relative colorimetric


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
    image = pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
    done, encoded = cv2.imencode(".png", image, _PNG_OPTIONS)
    data = encoded.tobytes()
    if not done:
        raise StorageError(f"{path}: cannot be encoded as PNG: check the memory of this computer")
    chunks = _curve_chunks(transfer)
    fields = {**caption.texts(), "XML:com.adobe.xmp": caption.xmp()}
    chunks += [_chunk(b"iTXt", _international(*field)) for field in fields.items()]
    store_image(path, b"".join([data[:_HEADER_END], *chunks, data[_HEADER_END:]]), pixels)


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
        "ImageDescription": caption.notes,
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
            return [_chunk(b"sRGB", _RENDERING_INTENT), _chunk(b"gAMA", _gamma(2.2))]
    return [_chunk(b"gAMA", _gamma(transfer.exponent or 1.0))]


def _gamma(exponent: float) -> bytes:
    return struct.pack(">I", round(100_000 / exponent))


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _international(keyword: str, text: str) -> bytes:
    """Return the data of an uncompressed iTXt chunk without a language tag."""
    clean = text.replace("\0", " ").encode("utf-8", "replace")
    return keyword.encode("latin-1") + b"\0\0\0\0\0" + clean
