"""One image for import: its samples and the metadata that the camera wrote."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenImageIO as oiio  # noqa: N813 - its own name for itself

from acquisition._errors import DataError
from acquisition._pixels.image_head import check_image_head
from acquisition._pixels.images import Image, read_image
from acquisition._pixels.opened_image import open_image
from acquisition._pixels.raw import read_raw, read_raw_header
from acquisition._suffixes import is_raw
from acquisition._text_files import text_of
from rig import MAX_PIXELS, UnreadableError, convert_parser_errors

# Some cameras measure the black level for each frame: allowed difference, relative to white.
_BLACK_SLACK = 0.001


@dataclass(frozen=True)
class ShotData:
    """Metadata of one shot from an image file; None if the file does not state it.

    Parameters
    ----------
    exposure_us
        Exposure time, microseconds.
    iso
        Sensitivity.
    taken
        Time of the shot by the camera's clock, which has no time zone; UTC is assumed.
    vendor, model
        Vendor and model of the camera; empty if not known.
    """

    exposure_us: float | None = None
    iso: float | None = None
    taken: datetime | None = None
    vendor: str = ""
    model: str = ""


@dataclass(frozen=True, eq=False)
class ImportedImage:
    """An image in the form in which a session stores it.

    Parameters
    ----------
    path
        Image file.
    pixels
        ``(H, W)`` or ``(H, W, 3)`` uint16; 8-bit samples keep their values.
    data
        Metadata from the file.
    bit_depth
        Number of significant low bits of a sample.
    cfa, black_level_dn, white_level_dn
        Colour filter pattern of a mosaic, or None, and the levels of the samples.
    black_levels_dn
        Black level at each position of the filter's block; empty without a colour filter.
    """

    path: Path
    pixels: npt.NDArray[np.uint16]
    data: ShotData
    bit_depth: int
    cfa: str | None
    black_level_dn: float
    white_level_dn: float
    black_levels_dn: tuple[float, ...] = ()

    def check_like(self, first: ImportedImage) -> None:
        """Refuse an image that cannot belong to the same recording as the first.

        Raises
        ------
        DataError
            If shape, colour filter or levels differ.
        """
        facts = (
            ("pixels", self.pixels.shape, first.pixels.shape),
            ("bits", self.bit_depth, first.bit_depth),
            ("colour filter", self.cfa, first.cfa),
            ("white level", self.white_level_dn, first.white_level_dn),
        )
        differing = [(name, one, other) for name, one, other in facts if one != other]
        one, other = self.black_level_dn, first.black_level_dn
        if abs(one - other) > _BLACK_SLACK * self.white_level_dn:
            differing.append(("black level", one, other))
        if differing:
            name, mine, firsts = differing[0]
            raise DataError(
                f"{self.path}: {name} {_text(mine)}, but {first.path.name} has {_text(firsts)}: "
                "all images of a recording must be of the same kind and camera settings"
            )


def read_for_import(path: Path, *, max_pixels: int = MAX_PIXELS) -> ImportedImage:
    """Read an image or a camera RAW file with its metadata.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If the file is damaged, of an unknown format, has more than ``max_pixels`` pixels, or holds
        float samples.
    """
    header = _header(path, max_pixels)
    if is_raw(path):
        raw = read_raw(path, max_pixels=max_pixels)
        data = replace(header, exposure_us=raw.exposure_us, iso=raw.iso, taken=raw.taken)
        return ImportedImage(
            path=path,
            pixels=raw.pixels,
            data=data,
            bit_depth=max(8, int(raw.white_level_dn).bit_length()),
            cfa=raw.cfa,
            black_level_dn=raw.black_level_dn,
            white_level_dn=raw.white_level_dn,
            black_levels_dn=raw.black_levels_dn,
        )
    return imported_image(path, read_image(path, max_pixels=max_pixels), header)


def imported_image(path: Path, pixels: Image, data: ShotData) -> ImportedImage:
    """Build an imported image from pixels that were already read.

    Raises
    ------
    DataError
        If the pixels are floats.
    """
    if pixels.dtype.kind != "u":
        raise DataError(f"{path}: a session holds whole numbers: save the image as 8 or 16 bit")
    bits = 8 * pixels.dtype.itemsize
    return ImportedImage(
        path=path,
        pixels=pixels.astype(np.uint16),
        data=data,
        bit_depth=bits,
        cfa=None,
        black_level_dn=0.0,
        white_level_dn=float(2**bits - 1),
    )


def read_shot_data(path: Path) -> ShotData:
    """Read the metadata of a shot from the file header only; missing metadata is no error.

    Raises
    ------
    DataError
        If the file has a suffix of camera RAW but is not one.
    """
    header = _header(path)
    if not is_raw(path):
        return header
    exposure_us, iso, taken = read_raw_header(path)
    return replace(header, exposure_us=exposure_us, iso=iso, taken=taken)


def _header(path: Path, max_pixels: int = MAX_PIXELS) -> ShotData:
    """Read Exif metadata; in TIFF-based RAW files OpenImageIO finds it with the thumbnail."""
    try:
        check_image_head(path, max_pixels)
        file = open_image(path)
    except (UnreadableError, FileNotFoundError):
        return ShotData()
    spec = file.spec()
    file.close()

    def attribute(*names: str) -> Any:
        values = (_attribute(spec, name) for name in names)
        return next((value for value in values if value is not None), None)

    return ShotData(
        exposure_us=_microseconds(attribute("ExposureTime")),
        iso=_number(attribute("Exif:PhotographicSensitivity", "Exif:ISOSpeedRatings")),
        taken=_time(attribute("Exif:DateTimeOriginal")),
        vendor=str(attribute("Make") or "").strip(),
        model=str(attribute("Model") or "").strip(),
    )


def _attribute(spec: oiio.ImageSpec, name: str) -> Any:
    """Return an attribute, or None if it is missing; text that is not UTF-8 is read as Latin-1."""
    try:
        with convert_parser_errors(name):
            value = spec.getattribute(name)
    except UnreadableError:
        return None
    if not isinstance(value, str) or value.isascii():
        return value
    return text_of(value.encode("utf-8", "surrogateescape"))


def _number(value: Any) -> float | None:
    valid = isinstance(value, (int, float)) and 0 < value < math.inf
    return float(value) if valid else None


def _microseconds(value: Any) -> float | None:
    seconds = _number(value)
    return None if seconds is None else float(f"{seconds * 1e6:.7g}")


def _time(value: Any) -> datetime | None:
    try:
        return datetime.strptime(str(value).strip(), "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
    except ValueError:
        return None


def _text(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else "none" if value is None else str(value)
