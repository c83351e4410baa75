"""The maps that photometric stereo computes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class StereoMaps:
    """Normals, albedo, residual and number of samples; 0 where there is no normal.

    See `PhotometricStereoResult`. The arrays are contiguous.
    """

    normals: Float
    albedo: Float
    residual: Float
    used: npt.NDArray[np.uint16]

    @classmethod
    def empty(cls, shape: tuple[int, ...]) -> Self:
        """Return maps of 0 for ``(H, W)`` pixels."""
        normals, albedo, residual = (
            np.zeros(size, np.float32) for size in ((*shape, 3), shape, shape)
        )
        return cls(normals, albedo, residual, np.zeros(shape, np.uint16))

    def clear(self) -> None:
        """Set all maps to 0."""
        for array in (self.normals, self.albedo, self.residual, self.used):
            array[:] = 0
