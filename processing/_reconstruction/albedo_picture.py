"""Albedo as a picture: 8-bit sRGB with a stated white."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from acquisition import SRGB, DataError
from rig import short_repr

# Highlights and wrong pixels may be far brighter than the rest; at most this share is clipped.
_CLIPPED = 0.001
_LEVELS = 4096
_BLOCK = 65536


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

    pixels: npt.NDArray[np.uint8]
    white: float

    def __repr__(self) -> str:
        return short_repr(self)


def albedo_picture(albedo: npt.NDArray[np.float32], mask: npt.NDArray[np.bool_]) -> AlbedoPicture:
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
    >>> from processing import albedo_picture
    >>> albedo = np.linspace(0, 0.5, 1000, dtype=np.float32).reshape(20, 50)
    >>> picture = albedo_picture(albedo, np.ones((20, 50), bool))
    >>> picture.pixels.dtype, round(picture.white, 2)
    (dtype('uint8'), 0.5)
    """
    if mask.shape != albedo.shape[:2] or albedo.ndim not in (2, 3):
        raise DataError(
            f"an albedo of shape {albedo.shape} does not fit a mask of shape {mask.shape}"
        )
    inside = albedo[mask]
    brightest = inside if inside.ndim == 1 else inside.max(axis=1, initial=0)
    brightest = brightest[np.isfinite(brightest) & (brightest > 0)]
    some = bool(brightest.size)
    white = float(np.quantile(brightest, 1 - _CLIPPED, method="lower")) if some else 1.0
    # By table, because a power of each value would take long.
    table = np.rint(SRGB.samples((np.arange(_LEVELS + 1) / _LEVELS) ** 2) * 255).astype(np.uint8)
    samples = np.zeros(inside.shape, np.uint8)
    for first in range(0, len(inside), _BLOCK):
        part = np.nan_to_num(inside[first : first + _BLOCK], nan=0.0, posinf=white)
        shares = np.clip(part, 0, white) / white
        samples[first : first + _BLOCK] = table[np.rint(np.sqrt(shares) * _LEVELS).astype(np.intp)]
    pixels = np.zeros(albedo.shape, np.uint8)
    pixels[mask] = samples
    return AlbedoPicture(pixels, white)
