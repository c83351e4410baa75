"""The result of a calibration with mirror spheres."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from acquisition import Lights
from calibration.spheres.geometry.ellipse import Ellipse
from calibration.spheres.outline.sphere_image import SphereImage
from calibration.spheres.solve.joint_refinement import KnownSpheres
from rig import Notice, short_repr
from rig.arrays import Bool, Float64


@dataclass(frozen=True)
class Sphere:
    """A mirror sphere in the images.

    Parameters
    ----------
    outline
        Ellipse of its outline in the image.
    coverage
        Share 0..1 of the circumference that is visible.
    rms_px
        Robust standard deviation of the edge in the images about the outline; NaN if only what the
        sphere mirrors determines the outline.
    centre_mm, radius_mm
        Centre in the house frame, and radius; None unless camera and radius are known.
    recording
        Number of the recording that shows it, from 0; 0 if there is only one.
    """

    outline: Ellipse
    coverage: float
    rms_px: float
    centre_mm: tuple[float, float, float] | None = None
    radius_mm: float | None = None
    recording: int = 0

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class SphereCalibration:
    """Lights, and the quality of the fit.

    Parameters
    ----------
    lights
        Lights with positions if camera and radius are known and there are two or more spheres,
        otherwise with directions. Intensities are 1: a highlight does not determine the intensity.
        Lights that were left out are not among these N; their notice names them.
    spheres
        K spheres, those of the first recording first.
    highlights_px
        ``(N, K, 2)`` highlight of light n on sphere k; NaN if it was not found.
    used
        ``(N, K)`` highlights that agree with the light.
    residuals_deg
        ``(N,)`` rms angle between the light and the directions measured at its used highlights. NaN
        for a direction from only one sphere.
    warnings
        Spheres and highlights that were left out, and doubts about the lights.
    pixel_mm, pixel_sigma_mm
        Size of a pixel at the height of the centres of the spheres, and its standard deviation;
        None unless radii are known and the working distance is not.
    shifts_px
        By how much the spheres are further right and down in the image of each light, by its id,
        if the camera was followed.
    """

    lights: Lights
    spheres: tuple[Sphere, ...]
    highlights_px: Float64
    used: Bool
    residuals_deg: Float64
    warnings: tuple[Notice, ...]
    pixel_mm: float | None = None
    pixel_sigma_mm: float | None = None
    shifts_px: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class SeenTogether:
    """Names of N lights; K spheres, the number of the recording of each, whether it was found.

    ``places_mm (N, 3)`` are the places of the lights that are known independently, and ``names``
    has a name for each recording, empty if there is only one.
    """

    lights: tuple[str, ...]
    places_mm: Float64
    images: list[SphereImage]
    of_recording: list[int]
    names: tuple[str, ...]
    found: list[bool]

    def without(self, k: int) -> SeenTogether:
        """Return all spheres but one."""
        kept = [i for i in range(len(self.images)) if i != k]
        return replace(
            self,
            images=[self.images[i] for i in kept],
            of_recording=[self.of_recording[i] for i in kept],
            found=[self.found[i] for i in kept],
        )

    def spheres(self, placed: KnownSpheres | None = None) -> tuple[Sphere, ...]:
        """Return the results of the spheres, with centres and radii if they are placed."""
        seen = tuple(
            Sphere(
                image.outline,
                image.coverage,
                image.rms_px if image.scatter_px is None else image.scatter_px,
                recording=k,
            )
            for image, k in zip(self.images, self.of_recording, strict=True)
        )
        if placed is None:
            return seen
        known = zip(seen, placed.centres_mm.tolist(), placed.radii_mm.tolist(), strict=True)
        return tuple(
            replace(sphere, centre_mm=(x, y, z), radius_mm=radius)
            for sphere, (x, y, z), radius in known
        )


def rms_deg(angle_deg: Float64, use: Bool) -> Float64:
    """Return the root mean square ``(N,)`` of the used angles among ``(N, K)``."""
    square = np.where(use, angle_deg, 0.0) ** 2
    return np.asarray(np.sqrt(square.sum(axis=1) / np.maximum(use.sum(axis=1), 1)))
