"""Field: the maps of one field of view, and the fine structure that registration compares."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import cv2
import numpy as np

from acquisition import DataError
from processing.maps.normal_map import NormalMap
from rig import short_repr
from rig.arrays import Bool, Float32

# Normals that are turned further away have no reliable slope.
_LEAST_FACING: Final = 0.15


@dataclass(frozen=True, eq=False)
class Field:
    """Maps of one field of view.

    Parameters
    ----------
    normal_map
        Normals of ``(H, W)`` pixels.
    albedo
        ``(H, W)`` float32, positive inside the mask; None if it is not known.
    sigma_deg
        ``(H, W)`` float32, root mean square angle between estimated and true normal in degrees, as
        in `NormalUncertainty`; None if it is not known.
    common_sigma_deg
        ``(H, W)`` float32, the part of it that neighbours have in common.

    Raises
    ------
    DataError
        If shapes differ.
    """

    normal_map: NormalMap
    albedo: Float32 | None = None
    sigma_deg: Float32 | None = None
    common_sigma_deg: Float32 | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for name in ("albedo", "sigma_deg", "common_sigma_deg"):
            values = getattr(self, name)
            if values is not None and values.shape != self.mask.shape:
                raise DataError(
                    f"{name} has shape {values.shape}, and the normals have {self.mask.shape}"
                )

    @property
    def mask(self) -> Bool:
        """``(H, W)`` bool, the pixels with a normal."""
        return self.normal_map.mask

    @cached_property
    def structure(self) -> Float32:
        """``(C, H, W)`` slopes dz/dx (right) and dz/dy (up), and the logarithm of the albedo.

        NaN outside the mask and where a value is not known.
        """
        x, y, z = np.moveaxis(self.normal_map.normals, 2, 0)
        seen = self.mask & (z > _LEAST_FACING)
        facing = np.where(seen, z, np.float32(np.nan))
        channels = [-x / facing, -y / facing]
        if self.albedo is not None:
            lit = seen & (self.albedo > 0)
            channels.append(np.log(np.where(lit, self.albedo, np.float32(np.nan))))
        return np.stack(channels).astype(np.float32)


def reduced(structure: Float32, size: int) -> Float32:
    """Return means over blocks, NaN where less than half of a block is known."""
    if size == 1:
        return structure
    rows, columns = (length // size for length in structure.shape[1:])
    cut = structure[:, : rows * size, : columns * size]
    blocks = cut.reshape(-1, rows, size, columns, size)
    known = np.isfinite(blocks).mean(axis=(2, 4))
    sums = np.nansum(blocks, axis=(2, 4), dtype=np.float64) / size**2
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(known >= 0.5, sums / known, np.nan).astype(np.float32)


def fine(structure: Float32, width: float) -> Float32:
    """Return what is finer than a width in pixels, 0 where it is not known."""
    made = np.empty_like(structure)
    for k, channel in enumerate(structure):
        known = np.isfinite(channel)
        weight = cv2.GaussianBlur(known.astype(np.float32), (0, 0), width)
        filled = np.where(known, channel, np.float32(0))
        smooth = cv2.GaussianBlur(filled, (0, 0), width) / np.maximum(weight, 1e-3)
        made[k] = np.where(known, channel - smooth, np.float32(0))
    return made
