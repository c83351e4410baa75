"""Camera RAW files, read without any processing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from math import isqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rawpy

from acquisition._errors import DataError, convert_read_errors
from acquisition.files.storage import library_path
from acquisition.pixels.dng_tags import (
    Tags,
    black_levels,
    check_dng,
    filter_block,
    read_dng_tags,
    white_levels,
)
from acquisition.pixels.images import Image
from rig import MAX_PIXELS, UnreadableError, short_repr
from rig.arrays import Float64, UInt8, UInt16
from rig.files import check_pixels, convert_parser_errors, read_head

_UNREADABLE = "not a readable camera RAW file"
_ROWS = 256


@dataclass(frozen=True, eq=False)
class RawFrame:
    """One RAW exposure: linear, without white balance, gamma correction or rotation.

    Parameters
    ----------
    pixels
        ``(H, W)`` uint16, the visible area of the sensor, one colour per pixel, as in the file;
        but where the black level does not repeat with the block of the filter, they are shifted
        to one level, and where white levels differ between colours, saturated ones have the
        highest.
    cfa
        Colours of the repeating block at the top left, row by row: ``GRBG`` means G R in the
        first row and B G in the second. Four letters for Bayer, 16 for Quad Bayer, 36 for X-Trans;
        None for a camera without a colour filter.
    black_level_dn
        Grey value without light, the mean over the block.
    white_level_dn
        Grey value at which a sample counts as saturated.
    black_levels_dn
        Grey value without light at each position of the block, in the order of ``cfa``.
    exposure_us
        Exposure time, microseconds; None if the file does not state it.
    iso
        Sensitivity; None if the file does not state it.
    taken
        Time of the exposure by the camera's clock, which has no time zone; UTC is assumed. None if
        the file does not state it.
    """

    pixels: UInt16
    cfa: str | None
    black_level_dn: float
    white_level_dn: float
    black_levels_dn: tuple[float, ...]
    exposure_us: float | None = None
    iso: float | None = None
    taken: datetime | None = None

    __repr__ = short_repr

    def levelled(self) -> UInt16:
        """Return the pixels with the same black level, ``black_level_dn``, at all positions."""
        side = isqrt(len(self.black_levels_dn))
        levels = np.reshape(self.black_levels_dn, (side, side))
        return level_black(self.pixels, levels, self.black_level_dn, self.white_level_dn)


def read_raw(path: str | Path, *, max_pixels: int = MAX_PIXELS) -> RawFrame:
    """Read the unprocessed mosaic of a camera RAW file with its levels and metadata.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If LibRaw cannot decode the file, it holds floating-point samples or several values per
        pixel, the sensor has more than ``max_pixels`` pixels, or the black level is not below the
        white level.

    Examples
    --------
    >>> from acquisition.pixels import read_raw
    >>> frame = read_raw("owl.CR2")  # doctest: +SKIP
    >>> frame.pixels.shape, frame.cfa, frame.black_level_dn  # doctest: +SKIP
    """
    path = Path(path)
    with _opened(path) as (raw, file_bytes, tags), convert_read_errors(path):
        sizes = raw.sizes
        check_pixels(sizes.raw_width, sizes.raw_height, 16, file_bytes, max_pixels)
        with convert_parser_errors(_UNREADABLE, rawpy.LibRawError):
            raw.unpack()
            pattern = raw.raw_pattern if raw.raw_type == rawpy.RawType.Flat else None
            if pattern is not None:
                pixels = np.array(raw.raw_image_visible, np.uint16)
                exposure_us, iso, taken = _shot_metadata(raw)
        if pattern is None:
            raise UnreadableError(
                "this RAW file holds all colours of each pixel and no mosaic: convert it to "
                "16-bit TIFF"
            )
        if not pixels.size or min(pixels.shape) < max(pattern.shape):
            raise UnreadableError("the file has no pixels and is damaged: copy it again")
        colours = _colours(raw, pattern.shape)
        top, left = sizes.top_margin, sizes.left_margin
        coloured = raw.num_colors > 1
        letters = filter_block(tags, top, left) if coloured else None
        if letters is None:
            letters = np.array(list(raw.color_desc.decode("ascii")))[colours]
        side = len(letters)
        levels = black_levels(tags, top, left, pixels.shape, side)
        if levels is None:
            levels = np.asarray(raw.black_level_per_channel, np.float64)[colours]
        black = float(levels.mean())
        whites = white_levels(tags, top, left, letters)
        if whites is None:
            whites = _white_levels(raw, colours)
        white = float(whites.max())
    if not 0 <= black < white:
        raise DataError(f"{path}: black level {black:g} is not below white level {white:g}")
    pixels = level_white(pixels, whites)
    if len(levels) > side:
        pixels = level_black(pixels, levels, black, white)
        levels = np.full((side, side), black)
    return RawFrame(
        pixels=pixels,
        cfa="".join(letters.ravel()) if coloured else None,
        black_level_dn=black,
        white_level_dn=white,
        black_levels_dn=tuple(levels.ravel().tolist()),
        exposure_us=exposure_us,
        iso=iso,
        taken=taken,
    )


def read_raw_header(path: Path) -> tuple[float | None, float | None, datetime | None]:
    """Return exposure (microseconds), ISO and time of a RAW file without decoding its pixels.

    Unknown values are returned as None. A DataError is raised if the file is not a RAW file.
    """
    with (
        _opened(path) as (raw, _, _),
        convert_read_errors(path),
        convert_parser_errors(_UNREADABLE, rawpy.LibRawError),
    ):
        return _shot_metadata(raw)


@contextmanager
def _opened(path: Path) -> Iterator[tuple[rawpy.RawPy, int, Tags]]:
    """Open a RAW file without decoding its pixels; yield it, its size in bytes and DNG tags."""
    raw = rawpy.RawPy()
    try:
        with convert_read_errors(path):
            _, file_bytes = read_head(path, 0)
            with convert_parser_errors(_UNREADABLE, rawpy.LibRawError):
                tags = read_dng_tags(path)
                check_dng(tags)
                raw.open_file(library_path(path))
        yield raw, file_bytes, tags
    finally:
        raw.close()


def _colours(raw: rawpy.RawPy, shape: tuple[int, int]) -> UInt8:
    """Return the numbers of the colours of the block at the top left; 0 without a filter."""
    if raw.num_colors == 1:
        return np.zeros((1, 1), np.uint8)
    colours = np.array(raw.raw_colors_visible[: shape[0], : shape[1]])
    if colours.max() >= min(len(raw.color_desc), len(raw.black_level_per_channel)):
        raise UnreadableError("the colour filter in the file is damaged: copy the file again")
    return colours


def _white_levels(raw: rawpy.RawPy, colours: UInt8) -> Float64:
    """Return the white levels of a block by the numbers of its colours, DN."""
    white = float(raw.white_level)
    stated = np.array(raw.camera_white_level_per_channel or [0] * 4, np.float64)
    # LibRaw has 0 for a second green like the first, and for colours without a level of their own.
    stated = np.where(stated > 0, stated, stated[1])
    return np.where(stated > 0, np.minimum(stated, white), white)[colours]


def _shot_metadata(raw: rawpy.RawPy) -> tuple[float | None, float | None, datetime | None]:
    shot = raw.other
    # LibRaw holds single precision, which has seven significant digits.
    exposure_us = _positive(float(f"{shot.shutter_speed * 1e6:.7g}"))
    return exposure_us, _positive(shot.iso_speed), _taken(shot.timestamp)


def _positive(value: float) -> float | None:
    """Return a value, or None if it is LibRaw's marker for an unknown value."""
    return float(value) if np.isfinite(value) and value > 0 else None


def _taken(time: datetime) -> datetime | None:
    return None if time.year <= 1970 else time.replace(tzinfo=UTC)


def level_white(pixels: UInt16, whites: Float64) -> UInt16:
    """Raise saturated samples to the highest white level of a block ``(K, K)`` that repeats."""
    white = whites.max()
    if (whites == white).all():
        return pixels
    level = pixels.copy()
    for y, x in np.ndindex(*whites.shape):
        plane = level[y :: whites.shape[0], x :: whites.shape[1]]
        plane[plane >= whites[y, x]] = white
    return level


def level_black(pixels: UInt16, levels: Float64, black: float, white: float) -> UInt16:
    """Shift samples from their black levels to one; saturated samples stay as they are.

    Parameters
    ----------
    pixels
        ``(H, W)`` samples, DN.
    levels
        Their black levels, DN: ``(H, W)``, or a block that repeats.
    black
        The one black level, DN.
    white
        Samples from this value on are saturated, DN.
    """
    shifts = np.rint(black - levels).astype(np.int32)
    if not shifts.any():
        return pixels
    level = np.empty_like(pixels)
    height, width = levels.shape
    columns = np.arange(pixels.shape[1]) % width
    # In parts, because shifts need more memory than samples.
    for top in range(0, len(pixels), _ROWS):
        rows = pixels[top : top + _ROWS]
        shifted = rows + shifts[np.arange(top, top + len(rows)) % height][:, columns]
        level[top : top + _ROWS] = np.where(rows >= white, rows, np.clip(shifted, 0, 65535))
    return level


class RawLevels(NamedTuple):
    """Colour filter and levels of the first file of a series, and its name."""

    name: str
    cfa: str | None
    black_dn: float
    white_dn: float


def read_levelled(path: Path, *, levels: RawLevels, max_pixels: int) -> Image:
    """Read the pixels of a file on the scale of the first; as stored if its levels are equal.

    Raises
    ------
    DataError
        As `read_raw`, or if the file has another colour filter pattern than the first.
    """
    frame = read_raw(path, max_pixels=max_pixels)
    if frame.cfa != levels.cfa:
        raise DataError(
            f"{path}: colour filter pattern {frame.cfa or 'none'}, but {levels.name} has "
            f"{levels.cfa or 'none'}: all images of a recording must be of one camera and show "
            "the same part of its sensor"
        )
    pixels, black, white = frame.levelled(), frame.black_level_dn, frame.white_level_dn
    if (black, white) == (levels.black_dn, levels.white_dn):
        return pixels
    signal = (pixels.astype(np.float32) - np.float32(black)) / np.float32(white - black)
    scaled = signal * np.float32(levels.white_dn - levels.black_dn) + np.float32(levels.black_dn)
    # Rounding must not lift or lower saturated samples.
    return np.where(pixels >= white, np.float32(levels.white_dn), scaled)
