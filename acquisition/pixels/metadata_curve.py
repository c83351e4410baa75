"""The transfer curve that the metadata of an image file state."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its own name for itself

from acquisition._errors import DataError
from acquisition.pixels.icc_curve import icc_curve
from acquisition.pixels.image_input import spec_attribute
from acquisition.pixels.png_file import chunks_before_samples
from acquisition.values.transfer_curve import LINEAR, SRGB, TransferCurve
from rig import UnreadableError
from rig.files import convert_parser_errors, read_head

# OpenImageIO's names of formats.
_DISPLAY: Final = {"jpeg": "JPEG", "webp": "WebP", "jpegxl": "JPEG XL"}
_LINEAR: Final = ("openexr", "hdr")
_NAMES: Final = _DISPLAY | {
    "png": "PNG", "tiff": "TIFF", "targa": "TGA", "bmp": "BMP", "openexr": "EXR", "hdr": "HDR",
    "jpeg2000": "JPEG 2000", "pnm": "PNM", "dpx": "DPX",
}  # fmt: skip
# The chunks in question are before the pixels; a longer head is that of a large profile.
_PNG_HEAD: Final = 1 << 16
# Transfer characteristics of ITU-T H.273 that a cICP chunk names.
_CICP: Final = {4: 2.2, 5: 2.8, 8: 1.0}
_CICP_SRGB: Final = 13
_CICP_UNSPECIFIED: Final = 2
# Adobe RGB (1998), 4.3.4.2.
_ADOBE_RGB: Final = 563 / 256


@dataclass(frozen=True)
class StatedCurve:
    """The transfer curve of a file, and why.

    Parameters
    ----------
    curve
        The curve that the metadata state, or that files of this kind have without metadata.
    origin
        What says so: ``ICC profile``, ``8-bit JPEG without colour metadata``.
    stated
        False if there are no metadata and the curve is that of the kind.
    """

    curve: TransferCurve
    origin: str
    stated: bool


def stated_curve(path: Path, kind: str, spec: oiio.ImageSpec) -> StatedCurve:
    """Return the transfer curve of an image that OpenImageIO has opened.

    A profile or value that cannot be used counts as missing; the origin mentions a profile.

    Parameters
    ----------
    path
        The file, of which the head is read if it is a PNG.
    kind
        OpenImageIO's name of the format.
    spec
        OpenImageIO's header of the file.
    """
    problem = ""
    if kind not in _LINEAR:
        chunks = _png_chunks(path) if kind == "png" else {}
        code_points = chunks.get(b"cICP", b"")
        found = _code_points(code_points)
        if found is None:
            try:
                found = _of_profile(spec)
            except UnreadableError as error:
                problem = f", whose ICC profile {error}"
        if found is None and len(code_points) == 4 and code_points[1] != _CICP_UNSPECIFIED:
            problem = f", whose cICP chunk names the unknown transfer {code_points[1]}"
        found = found or _of_png(chunks) or _of_exif(spec)
        if found is not None:
            return StatedCurve(found[0], f"{found[1]}{problem}", stated=True)
    bits = 8 * spec.format.size()
    curve = SRGB if kind in _DISPLAY and bits == 8 else LINEAR
    what = f"{bits}-bit {_NAMES.get(kind, kind)}"
    return StatedCurve(curve, f"{what}{problem or ' without colour metadata'}", stated=False)


def _code_points(data: bytes) -> tuple[TransferCurve, str] | None:
    """Return the curve of a cICP chunk: PNG 3, 11.3.2.6."""
    if len(data) != 4:
        return None
    if data[1] == _CICP_SRGB:
        return SRGB, "PNG cICP chunk"
    power = _CICP.get(data[1])
    return None if power is None else (TransferCurve.power(power), "PNG cICP chunk")


def _of_profile(spec: oiio.ImageSpec) -> tuple[TransferCurve, str] | None:
    profile = spec_attribute(spec, "ICCProfile")
    if profile is None:
        return None
    with convert_parser_errors("cannot be read"):
        data = np.asarray(profile, np.uint8).tobytes()
    return icc_curve(data), "ICC profile"


def _of_png(chunks: dict[bytes, bytes]) -> tuple[TransferCurve, str] | None:
    """Return the curve of an sRGB or gAMA chunk: PNG 3, 11.3.2.5 and 11.3.2.2."""
    if len(chunks.get(b"sRGB", b"")) == 1:
        return SRGB, "PNG sRGB chunk"
    gamma = int.from_bytes(chunks.get(b"gAMA", b""))
    if not 0 < gamma < 2**32:
        return None
    try:
        # Rounded, so that 45455 is 2.2.
        return TransferCurve.power(round(100_000 / gamma, 3)), "PNG gAMA chunk"
    except DataError:
        return None


def _of_exif(spec: oiio.ImageSpec) -> tuple[TransferCurve, str] | None:
    """Return the curve of the colour space of Exif: 1 is sRGB, 2 is used for Adobe RGB."""
    match spec_attribute(spec, "Exif:ColorSpace"):
        case 1:
            return SRGB, "Exif colour space"
        case 2:
            return TransferCurve.power(_ADOBE_RGB), "Exif colour space"
    return None


def _png_chunks(path: Path) -> dict[bytes, bytes]:
    """Return the small chunks before the pixels, as far as they are in the head of the file."""
    head = io.BytesIO(read_head(path, _PNG_HEAD)[0])
    chunks: dict[bytes, bytes] = {}
    for kind, size in chunks_before_samples(head):
        chunks.setdefault(kind, head.read(size))
    return chunks
