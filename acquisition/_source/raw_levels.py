"""Camera RAW files of a series, whose black and white levels may differ, on one scale."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from acquisition._errors import DataError
from acquisition._pixels.images import Image
from acquisition._pixels.raw import read_raw


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
