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


class AlbedoPicture(NamedTuple):
    """An albedo as sRGB samples, and the albedo at white.

    Parameters
    ----------
    pixels
        ``(H, W)`` or ``(H, W, 3)`` uint8, black outside the mask.
    white
        Albedo of a pixel of 255; the linear value of a sample is a share of it.
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
        If the shapes differ, or no value inside the mask is positive and finite.
    """
    if mask.shape != albedo.shape[:2] or albedo.ndim not in (2, 3):
        raise DataError(
            f"an albedo of shape {albedo.shape} does not fit a mask of shape {mask.shape}"
        )
    inside = albedo[mask]
    brightest = inside if inside.ndim == 1 else inside.max(axis=1, initial=0)
    brightest = brightest[np.isfinite(brightest) & (brightest > 0)]
    if not brightest.size:
        raise DataError("the albedo is not positive anywhere in the mask")
    white = float(np.quantile(brightest, 1 - _CLIPPED, method="lower"))
    # By table, because a power of each value would take long.
    shares = np.clip(np.nan_to_num(inside / np.float32(white), nan=0.0, posinf=1.0), 0, 1)
    levels = np.rint(np.sqrt(shares) * _LEVELS).astype(np.int32)
    table = np.rint(SRGB.samples((np.arange(_LEVELS + 1) / _LEVELS) ** 2) * 255).astype(np.uint8)
    pixels = np.zeros(albedo.shape, np.uint8)
    pixels[mask] = table[levels]
    return AlbedoPicture(pixels, white)
