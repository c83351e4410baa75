"""Camera RAW files, read without any processing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import numpy.typing as npt
import rawpy

from acquisition._errors import DataError, convert_read_errors
from acquisition._storage import library_path
from rig import MAX_PIXELS, check_pixels, convert_parser_errors, read_head, short_repr

_UNREADABLE = "not a readable camera RAW file"


@dataclass(frozen=True, eq=False)
class RawFrame:
    """One RAW exposure: linear, without white balance, gamma correction or rotation.

    Parameters
    ----------
    pixels
        ``(H, W)`` uint16, the visible area of the sensor, one colour per pixel.
    cfa
        Colours of the repeating block at the top left, row by row: ``GRBG`` means G R in the
        first row and B G in the second. Four letters for Bayer, 36 for X-Trans.
    black_level_dn
        Grey value without light, the mean over the colours.
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

    pixels: npt.NDArray[np.uint16]
    cfa: str
    black_level_dn: float
    white_level_dn: float
    black_levels_dn: tuple[float, ...]
    exposure_us: float | None = None
    iso: float | None = None
    taken: datetime | None = None

    __repr__ = short_repr


def read_raw(path: str | Path, *, max_pixels: int = MAX_PIXELS) -> RawFrame:
    """Read the unprocessed mosaic of a camera RAW file with its levels and metadata.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If LibRaw cannot decode the file, the sensor has no colour filter mosaic or more than
        ``max_pixels`` pixels, or the black level is not below the white level.

    Examples
    --------
    >>> from acquisition import read_raw
    >>> frame = read_raw("owl.CR2")  # doctest: +SKIP
    >>> frame.pixels.shape, frame.cfa, frame.black_level_dn  # doctest: +SKIP
    """
    path = Path(path)
    with _opened(path) as (raw, file_bytes):
        with convert_read_errors(path):
            sizes = raw.sizes
            check_pixels(sizes.raw_width, sizes.raw_height, 16, file_bytes, max_pixels)
        with convert_read_errors(path), convert_parser_errors(_UNREADABLE, rawpy.LibRawError):
            raw.unpack()
            pattern = raw.raw_pattern if raw.raw_type == rawpy.RawType.Flat else None
            if pattern is not None:
                pixels = np.array(raw.raw_image_visible, np.uint16)
                rows, columns = pattern.shape
                block = np.array(raw.raw_colors_visible[:rows, :columns]).ravel()
                colours = raw.color_desc.decode("ascii")
                levels = np.asarray(raw.black_level_per_channel, np.float64)
                white = float(raw.white_level)
                exposure_us, iso, taken = _shot_metadata(raw)
    if pattern is None:
        raise DataError(
            f"{path}: this RAW file has no colour filter mosaic: convert it to 16-bit TIFF"
        )
    if not pixels.size or len(block) != rows * columns:
        raise DataError(f"{path}: the file has no pixels and is damaged: copy it again")
    if block.max() >= min(len(colours), len(levels)):
        raise DataError(f"{path}: the colour filter in the file is damaged: copy the file again")
    black = float(np.mean(levels[np.unique(block)]))
    if not 0 <= black < white:
        raise DataError(f"{path}: black level {black:g} is not below white level {white:g}")
    return RawFrame(
        pixels=pixels,
        cfa="".join(colours[index] for index in block),
        black_level_dn=black,
        white_level_dn=white,
        black_levels_dn=tuple(levels[block].tolist()),
        exposure_us=exposure_us,
        iso=iso,
        taken=taken,
    )


def read_raw_header(path: Path) -> tuple[float | None, float | None, datetime | None]:
    """Return exposure (microseconds), ISO and time of a RAW file without decoding its pixels.

    Unknown values are returned as None. A DataError is raised if the file is not a RAW file.
    """
    with (
        _opened(path) as (raw, _),
        convert_read_errors(path),
        convert_parser_errors(_UNREADABLE, rawpy.LibRawError),
    ):
        return _shot_metadata(raw)


@contextmanager
def _opened(path: Path) -> Iterator[tuple[rawpy.RawPy, int]]:
    """Open a RAW file without decoding its pixels; yield it and the size of the file in bytes."""
    raw = rawpy.RawPy()
    try:
        with convert_read_errors(path):
            _, file_bytes = read_head(path, 0)
            with convert_parser_errors(_UNREADABLE, rawpy.LibRawError):
                raw.open_file(library_path(path))
        yield raw, file_bytes
    finally:
        raw.close()


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
