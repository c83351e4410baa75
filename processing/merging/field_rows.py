"""A field of view whose maps are read in rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from acquisition import MapRows
from processing.maps.normal_map import NormalMap
from processing.registration import Field
from rig import short_repr
from rig.arrays import Bool, Float32

Size = tuple[int, int]


@dataclass(frozen=True, eq=False)
class FieldRows:
    """Maps of one field of view, in memory or in files.

    Parameters
    ----------
    name
        Name for messages.
    normals
        ``(H, W, 3)`` unit vectors inside the mask.
    mask
        ``(H, W)`` bool, the pixels with a normal.
    albedo
        ``(H, W)`` or ``(H, W, 3)``; None if it is not known.
    sigma_deg
        ``(H, W)`` standard deviations of the normals in degrees, NaN where not known; None if they
        are not known.
    common_sigma_deg
        The part of them that all pixels have in common.
    """

    name: str
    normals: MapRows
    mask: Bool
    albedo: MapRows | None = None
    sigma_deg: MapRows | None = None
    common_sigma_deg: float = 0.0

    __repr__ = short_repr

    @classmethod
    def of(cls, field: Field, name: str) -> Self:
        """Return the rows of a field in memory."""
        common = 0.0
        if field.common_sigma_deg is not None:
            common = float(np.nanmedian(field.common_sigma_deg[field.normal_map.mask]))
        normals, mask = field.normal_map.normals, field.normal_map.mask
        return cls(name, normals, mask, field.albedo, field.sigma_deg, common)

    @property
    def size(self) -> Size:
        """(height, width) in pixels."""
        height, width = self.mask.shape
        return height, width

    def part(self, rows: slice, columns: slice) -> Field | None:
        """Return a rectangle of the field, its albedo in one channel; None without a normal."""
        mask = np.ascontiguousarray(self.mask[rows, columns])
        if not mask.any():
            return None
        normals = np.where(mask[..., None], self.normals[rows][:, columns], np.float32(0))
        return Field(
            NormalMap.of_unit_vectors(np.ascontiguousarray(normals, np.float32), mask),
            grey(self.albedo, rows, columns),
            None if self.sigma_deg is None else self.sigma_deg[rows][:, columns],
        )


def grey(albedo: MapRows | None, rows: slice, columns: slice) -> Float32 | None:
    """Return a rectangle of an albedo, the mean of its channels."""
    if albedo is None:
        return None
    part = albedo[rows][:, columns]
    return np.ascontiguousarray(part if part.ndim == 2 else part.mean(axis=2), np.float32)
