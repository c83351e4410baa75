"""Camera RAW files as the sensor wrote them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import rawpy

from acquisition._errors import DataError, MissingPathError
from acquisition._suffixes import RAW_SUFFIXES


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
    """

    pixels: npt.NDArray[np.uint16]
    cfa: str
    black_level_dn: float
    white_level_dn: float


def is_raw(path: Path) -> bool:
    """Say whether a file's suffix is one of camera RAW."""
    return path.suffix.lower() in RAW_SUFFIXES


def read_raw(path: str | Path) -> RawFrame:
    """Read a camera RAW file with everything LibRaw knows and nothing it would improve.

    Raises
    ------
    MissingPathError
        If there is no such file.
    DataError
        If LibRaw cannot decode it, or the sensor has no colour filter mosaic.
    """
    path = Path(path)
    if not path.exists():
        raise MissingPathError(f"{path}: no such file")
    try:
        with rawpy.imread(str(path)) as raw:
            if raw.raw_type != rawpy.RawType.Flat or raw.raw_pattern is None:
                raise DataError(
                    f"{path}: this RAW holds no colour filter mosaic: convert it to 16-bit TIFF"
                )
            pixels = np.array(raw.raw_image_visible, np.uint16)
            rows, columns = raw.raw_pattern.shape
            block = np.array(raw.raw_colors_visible[:rows, :columns])
            colours = raw.color_desc.decode("ascii")
            cfa = "".join(colours[index] for index in block.ravel())
            black = float(np.mean(np.asarray(raw.black_level_per_channel)[np.unique(block)]))
            white = float(raw.white_level)
    except rawpy.LibRawError as error:
        reason = error.args[0] if error.args else error
        text = reason.decode("ascii", "replace") if isinstance(reason, bytes) else str(reason)
        raise DataError(f"{path}: not a readable camera RAW file ({text})") from error
    if not 0 <= black < white:
        raise DataError(f"{path}: black level {black:g} is not below white level {white:g}")
    return RawFrame(pixels, cfa, black, white)
