"""Images in colour, and the maps that their solutions fill."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, Lights
from calibration import StackNoise
from processing._stereo.light_model import LightModel

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class ColourImages:
    """Images in colour, or some rows of them.

    Parameters
    ----------
    values
        ``(N, H, W, 3)`` linear radiance. Samples that are not finite are left out.
    lights, mask, points_mm
        As in `photometric_stereo`.
    noise
        Law of the noise of the values; None if it is unknown.
    camera, rows
        Camera, and the rows of its image; None for all.
    """

    values: Float
    lights: Lights
    mask: Mask
    points_mm: npt.NDArray[np.float64] | None
    noise: StackNoise | None
    camera: CameraModel | None = None
    rows: npt.NDArray[np.intp] | None = None

    @property
    def model(self) -> LightModel:
        """Light vectors at the pixels."""
        return LightModel(self.lights, self.points_mm, self.mask)


@dataclass(frozen=True, eq=False)
class ColourMaps:
    """Maps of images in colour with S solutions: one for each colour, or one of all.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` unit normals; 0 at pixels without a normal.
    albedo
        ``(H, W, 3)``.
    residual
        ``(H, W)``, luma of the residuals.
    used
        ``(S, H, W)`` uint16, number of samples.
    solved
        ``(S,)`` bool, whether a solution has any normal.
    """

    normals: Float
    albedo: Float
    residual: Float
    used: npt.NDArray[np.uint16]
    solved: npt.NDArray[np.bool_]

    @classmethod
    def empty(cls, shape: tuple[int, ...], solutions: int) -> Self:
        """Return maps of 0."""
        return cls(
            np.zeros((*shape, 3), np.float32),
            np.zeros((*shape, 3), np.float32),
            np.zeros(shape, np.float32),
            np.zeros((solutions, *shape), np.uint16),
            np.zeros(solutions, np.bool_),
        )

    def write(self, rows: slice, part: ColourMaps, inside: slice) -> None:
        """Copy rows of other maps."""
        self.normals[rows] = part.normals[inside]
        self.albedo[rows] = part.albedo[inside]
        self.residual[rows] = part.residual[inside]
        self.used[:, rows] = part.used[:, inside]
        self.solved[:] |= part.solved

    def fewest_used(self) -> npt.NDArray[np.uint16]:
        """Return the samples of the solution with the fewest.

        Solutions that have no normal at all do not count.
        """
        used: npt.NDArray[np.uint16] = self.used[
            self.solved if self.solved.any() else slice(0, 1)
        ].min(axis=0)
        return used
