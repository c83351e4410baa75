"""The maps that photometric stereo computes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from acquisition import DataError
from rig import short_repr
from rig.arrays import Float32, UInt16


@dataclass(frozen=True, eq=False)
class StereoMaps:
    """Normals, albedo, residual and number of samples of the pixels of images.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32 unit normals; 0 at pixels without a normal.
    albedo, residual
        ``(H, W)`` float32, see `PhotometricStereoResult`.
    used
        ``(H, W)`` uint16, number of samples.

    Examples
    --------
    >>> from processing import StereoMaps
    >>> StereoMaps.empty((480, 640)).normals.shape
    (480, 640, 3)
    """

    normals: Float32
    albedo: Float32
    residual: Float32
    used: UInt16

    __repr__ = short_repr

    @staticmethod
    def _forms(shape: tuple[int, ...]) -> dict[str, tuple[tuple[int, ...], type]]:
        """Return shape and type of each map."""
        one = shape, np.float32
        return {
            "normals": ((*shape, 3), np.float32),
            "albedo": one,
            "residual": one,
            "used": (shape, np.uint16),
        }

    @classmethod
    def empty(cls, shape: tuple[int, ...]) -> Self:
        """Return maps of 0 for ``(H, W)`` pixels."""
        return cls(**{name: np.zeros(*form) for name, form in cls._forms(shape).items()})

    def clear(self) -> None:
        """Set all maps to 0."""
        for array in vars(self).values():
            array[:] = 0

    def check(self, shape: tuple[int, ...]) -> None:
        """Refuse maps that cannot be filled for ``(H, W)`` pixels, by `DataError`."""
        for name, (size, kind) in self._forms(shape).items():
            array = getattr(self, name)
            fits = array.shape == size and array.dtype == kind
            if not (fits and array.flags.c_contiguous and array.flags.writeable):
                raise DataError(
                    f"the given map {name} must be a contiguous, writable {np.dtype(kind)} array "
                    f"of shape {size}: StereoMaps.empty({shape}) makes one"
                )
