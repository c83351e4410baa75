"""Camera RAW files as the sensor wrote them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import numpy.typing as npt
import rawpy

from acquisition._errors import DataError, declared
from acquisition._storage import library_path
from acquisition._suffixes import RAW_SUFFIXES
from rig import MAX_PIXELS, check_pixels, read_head, refusing

_UNREADABLE = "not a readable camera RAW file"


@dataclass(frozen=True, eq=False)
class RawFrame:
    """One RAW exposure: linear, no white balance, no gamma, no rotation.

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
        Grey value without light of each place of the block, in the order of ``cfa``.
    exposure_us
        Exposure time, microseconds; None where the file does not tell.
    iso
        Sensitivity; None where the file does not tell.
    taken
        When it was taken, by the camera's clock, which knows no time zone: UTC is put in its place.
        None where the file does not tell.
    """

    pixels: npt.NDArray[np.uint16]
    cfa: str
    black_level_dn: float
    white_level_dn: float
    black_levels_dn: tuple[float, ...]
    exposure_us: float | None = None
    iso: float | None = None
    taken: datetime | None = None


def is_raw(path: Path) -> bool:
    """Say whether a file's suffix is one of camera RAW."""
    return path.suffix.lower() in RAW_SUFFIXES


def read_raw(path: str | Path, *, max_pixels: int = MAX_PIXELS) -> RawFrame:
    """Read a camera RAW file with everything LibRaw knows and nothing it would improve.

    Raises
    ------
    MissingPathError
        If there is no such file.
    DataError
        If LibRaw cannot decode it, the sensor has no colour filter mosaic or more than
        ``max_pixels``, or its levels make no sense.
    """
    path = Path(path)
    with _opened(path) as (raw, file_bytes):
        with declared(path):
            sizes = raw.sizes
            check_pixels(sizes.raw_width, sizes.raw_height, 16, file_bytes, max_pixels)
        with declared(path), refusing(_UNREADABLE, rawpy.LibRawError):
            raw.unpack()
            pattern = raw.raw_pattern if raw.raw_type == rawpy.RawType.Flat else None
            if pattern is not None:
                pixels = np.array(raw.raw_image_visible, np.uint16)
                rows, columns = pattern.shape
                block = np.array(raw.raw_colors_visible[:rows, :columns]).ravel()
                colours = raw.color_desc.decode("ascii")
                levels = np.asarray(raw.black_level_per_channel, np.float64)
                white = float(raw.white_level)
                exposure_us, iso, taken = _told(raw)
    if pattern is None:
        raise DataError(
            f"{path}: this RAW holds no colour filter mosaic: convert it to 16-bit TIFF"
        )
    if not pixels.size or len(block) != rows * columns:
        raise DataError(f"{path}: holds no pixels: the file is damaged, copy it again")
    if block.max() >= min(len(colours), len(levels)):
        raise DataError(f"{path}: its colour filter is damaged: copy the file again")
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

    What is not known is None. A DataError names a file that is no RAW.
    """
    with (
        _opened(path) as (raw, _),
        declared(path),
        refusing(_UNREADABLE, rawpy.LibRawError),
    ):
        return _told(raw)


@contextmanager
def _opened(path: Path) -> Iterator[tuple[rawpy.RawPy, int]]:
    """Open a RAW file; give it, its pixels still packed, and the size of the file."""
    raw = rawpy.RawPy()
    try:
        with declared(path):
            _, file_bytes = read_head(path, 0)
            with refusing(_UNREADABLE, rawpy.LibRawError):
                raw.open_file(library_path(path))
        yield raw, file_bytes
    finally:
        raw.close()


def _told(raw: rawpy.RawPy) -> tuple[float | None, float | None, datetime | None]:
    shot = raw.other
    # LibRaw holds single precision, of which seven digits mean something.
    exposure_us = _positive(float(f"{shot.shutter_speed * 1e6:.7g}"))
    return exposure_us, _positive(shot.iso_speed), _taken(shot.timestamp)


def _positive(value: float) -> float | None:
    """Return a value unless it is LibRaw's sign for not known."""
    return float(value) if np.isfinite(value) and value > 0 else None


def _taken(time: datetime) -> datetime | None:
    return None if time.year <= 1970 else time.replace(tzinfo=UTC)
