"""Images of an object with their solution, which is judged."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, Lights
from calibration import StackNoise
from processing._stereo.frames import Frames
from processing._stereo.light_model import LightModel
from processing._stereo.noise_law import NoiseLaw
from processing._uncertainty.reference_solver import ReferenceSolver

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False, kw_only=True)
class SolvedStack:
    """Images of an object with their solution.

    Parameters
    ----------
    values
        ``(N, H, W)``, or ``(N, H, W, 3)`` in colour.
    lights, mask, points_mm, camera, depth_sigma, noise
        As in `normal_uncertainty`.
    normals, albedo
        Given normals ``(H, W, 3)``, and albedo ``(H, W)``, or ``(H, W, 3)`` in colour.
    """

    values: Float
    lights: Lights
    mask: Mask
    normals: Float
    albedo: Float
    points_mm: npt.NDArray[np.float64] | None = None
    camera: CameraModel | None = None
    depth_sigma: float = 0.0
    noise: StackNoise | None = None

    def of_colours(self) -> list[SolvedStack]:
        """Return the channels of images in colour."""
        return [
            replace(
                self,
                values=np.ascontiguousarray(self.values[..., channel]),
                albedo=np.ascontiguousarray(self.albedo[..., channel]),
                noise=None if self.noise is None else self.noise.of_colour(channel),
            )
            for channel in range(self.values.shape[-1])
        ]

    def frames(self) -> Frames:
        return Frames(self.values)

    def model(self) -> LightModel:
        """Return the light vectors at the pixels."""
        return LightModel(self.lights, self.points_mm, self.mask)

    def solver(self) -> ReferenceSolver:
        """Return what solves the pixels again."""
        scaled = self.normals, self.albedo
        return ReferenceSolver(self.lights, scaled, self.points_mm, self.camera, self.depth_sigma)

    def law(self) -> NoiseLaw | None:
        """Return the law of the noise; None if it is unknown."""
        if self.noise is None:
            return None
        return NoiseLaw(self.noise, (len(self.values), *self.mask.shape))
