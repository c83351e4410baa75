"""Albedo as a picture: 8-bit sRGB with a stated white."""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from acquisition import SRGB, DataError, MapRows
from acquisition.files import rows_in_bands
from rig import short_repr
from rig.arrays import Bool, Float32, UInt8

# Highlights and wrong pixels may be far brighter than the rest; at most this share is clipped.
_CLIPPED = 0.001
_LEVELS = 4096
# Pixels that are encoded, and read, at once.
_BLOCK = 65536
_READ = 2_000_000


class AlbedoPicture(NamedTuple):
    """An albedo as sRGB samples, and the albedo at white.

    Parameters
    ----------
    pixels
        ``(H, W)`` or ``(H, W, 3)`` uint8, black outside the mask.
    white
        Albedo of a sample of 255; the linear value of a sample is a share of it. 1 if no albedo is
        positive and finite.
    """

    pixels: UInt8
    white: float

    def __repr__(self) -> str:
        return short_repr(self)


def albedo_picture(albedo: Float32, mask: Bool) -> AlbedoPicture:
    """Encode an albedo with the sRGB curve (IEC 61966-2-1); the brightest 0.1 % may be clipped.

    Parameters
    ----------
    albedo
        ``(H, W)`` or ``(H, W, 3)`` linear values, at least 0 inside the mask.
    mask
        ``(H, W)`` bool, not empty.

    Raises
    ------
    DataError
        If the shapes differ.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.colour import albedo_picture
    >>> albedo = np.linspace(0, 0.5, 1000, dtype=np.float32).reshape(20, 50)
    >>> picture = albedo_picture(albedo, np.ones((20, 50), bool))
    >>> picture.pixels.dtype, round(picture.white, 2)
    (dtype('uint8'), 0.5)
    """
    white = albedo_white(albedo, mask)
    pixels = np.zeros(albedo.shape, np.uint8)
    for rows in rows_in_bands(len(mask), mask.shape[1], _BLOCK):
        pixels[rows] = albedo_samples(albedo[rows], mask[rows], white)
    return AlbedoPicture(pixels, white)


def albedo_white(albedo: MapRows, mask: Bool) -> float:
    """Return the albedo at white of `albedo_picture`; the rows of a map are read band by band.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.colour import albedo_white
    >>> round(albedo_white(np.linspace(0, 0.5, 1000).reshape(20, 50), np.ones((20, 50), bool)), 2)
    0.5
    """
    if mask.shape != albedo.shape[:2] or len(albedo.shape) not in (2, 3):
        raise DataError(
            f"an albedo of shape {albedo.shape} does not fit a mask of shape {mask.shape}"
        )
    parts = []
    for rows in rows_in_bands(len(mask), mask.shape[1], _READ):
        inside = albedo[rows][mask[rows]]
        brightest = inside if inside.ndim == 1 else inside.max(axis=1, initial=0)
        parts.append(brightest[np.isfinite(brightest) & (brightest > 0)])
    found = np.concatenate(parts)
    if not found.size:
        return 1.0
    return float(np.quantile(found, 1 - _CLIPPED, method="lower", overwrite_input=True))


def albedo_samples(albedo: Float32, mask: Bool, white: float) -> UInt8:
    """Return rows of the pixels of `albedo_picture`.

    Parameters
    ----------
    albedo, mask
        Rows of those of the picture.
    white
        What `albedo_white` returns for all rows.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.colour import albedo_samples
    >>> albedo_samples(np.array([[0.0, 0.1, 0.5]], np.float32), np.ones((1, 3), bool), 0.5)
    array([[  0, 124, 255]], dtype=uint8)
    """
    table = _table()
    part = np.nan_to_num(albedo[mask], nan=0.0, posinf=white)
    shares = np.clip(part, 0, white) / white
    pixels = np.zeros(albedo.shape, np.uint8)
    pixels[mask] = table[np.rint(np.sqrt(shares) * _LEVELS).astype(np.intp)]
    return pixels


@functools.cache
def _table() -> UInt8:
    """Return sRGB samples by the square root of light: a power of each value would take long."""
    return np.rint(SRGB.samples((np.arange(_LEVELS + 1) / _LEVELS) ** 2) * 255).astype(np.uint8)
