"""What `reconstruct` returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition import Lights, MapRows, Source
from processing._metrics import AngularError
from processing._reconstruction.light_strengths import LightStrengths
from processing._reconstruction.near_height import NearHeight
from processing._reconstruction.quality import ImageQuality
from processing._stereo.photometric_stereo import PhotometricStereoResult
from processing._surface.height_map import HeightMap
from processing._uncertainty.normal_uncertainty import NormalUncertainty
from processing._uncertainty.pixel_variances import Origin
from processing._uncertainty.sample_kind import SampleKind
from rig import Notice


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """The normals and the height of a recorded object, with the data they were computed from.

    Parameters
    ----------
    source
        The recording.
    lights
        The lights of the images that were used, in their order.
    mask
        ``(H, W)`` bool, the object: the mask of the source, or one computed from the images.
    stereo
        Normals of the valid pixels, gray albedo and residual.
    albedo
        ``(H, W, 3)`` float32 linear RGB if the images have colour, else the gray albedo
        ``(H, W)``; see `colour_albedo`. 0 outside the mask of the normals.
    uncertainty
        Standard deviations of the normals, what the samples show, and why pixels are not valid.
    specular
        ``(H, W)`` float32 mean light above a matte surface, see `specular_residual`.
    surface
        The height; None if it was not requested.
    quality
        Agreement of images, lights and normals.
    excluded
        Names of the images that were left out because they disagree with the others.
    strengths
        Strengths of the lights, if they were estimated.
    error
        Error of the normals over `mask`; None if the source has no ground truth.
    previews
        The first and the last linear image, each ``(H, W)`` float32.
    near_height
        Where the surface is, under near lights; None under distant lights.
    warnings
        Warnings about the source, the stack, the normals and the height.
    """

    source: Source
    lights: Lights
    mask: npt.NDArray[np.bool_]
    stereo: PhotometricStereoResult
    albedo: npt.NDArray[np.float32]
    uncertainty: NormalUncertainty
    specular: npt.NDArray[np.float32]
    surface: HeightMap | None
    quality: ImageQuality
    excluded: tuple[str, ...]
    strengths: LightStrengths | None
    error: AngularError | None
    previews: tuple[npt.NDArray[np.float32], ...]
    near_height: NearHeight | None
    warnings: tuple[Notice, ...]

    @property
    def valid(self) -> npt.NDArray[np.bool_]:
        """``(H, W)`` bool, the pixels with a normal."""
        return self.stereo.normal_map.mask

    @property
    def noise(self) -> Origin:
        """Where the law of the noise is from, see `NormalUncertainty`."""
        return self.uncertainty.noise

    @property
    def neighbour_correlation(self) -> float:
        """Whether the residuals are noise, see `NormalUncertainty`."""
        return self.uncertainty.neighbour_correlation

    @property
    def maps(self) -> dict[str, MapRows]:
        """The maps of a result by the names of their files."""
        samples = self.uncertainty.samples
        return {
            "normals": self.stereo.normal_map.normals,
            "albedo": self.albedo,
            "residual": self.stereo.residual,
            "specular": self.specular,
            "used": self.stereo.used,
            "normal_sigma_deg": self.uncertainty.sigma_deg,
            "normal_sigma_common_deg": self.uncertainty.common_sigma_deg,
            "validity": self.uncertainty.reason,
            **{f"samples_{kind.name.lower()}": samples[kind] for kind in SampleKind},
        }

    def __repr__(self) -> str:
        parts = [str(self.source.path), repr(self.stereo.normal_map)]
        if self.surface is not None:
            parts.append(f"height in {self.surface.unit}")
        if self.error is not None:
            parts.append(f"mean error {self.error.mae_deg:.2f} deg")
        return f"Reconstruction({', '.join(parts)})"
