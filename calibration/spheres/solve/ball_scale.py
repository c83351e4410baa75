"""Size of a pixel on the object from spheres of known radius, without a working distance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from acquisition import CameraModel
from calibration._errors import EstimateError
from calibration.spheres.geometry.cone import Cone
from calibration.spheres.outline.sphere_image import SphereImage
from rig.arrays import Float64

# Sizes of pixels by several spheres differ by less, or a radius is wrong.
_MOST_APART = 0.08


def pixel_size(
    images: Sequence[SphereImage],
    radii_mm: Float64,
    camera: CameraModel | None = None,
    cones: Sequence[Cone] = (),
) -> tuple[float, float]:
    """Return the size of a pixel at the height of the centres of spheres, and its sd, in mm.

    Parameters
    ----------
    images
        K spheres.
    radii_mm
        ``(K,)`` their radii.
    camera, cones
        The camera and the K cones of its rays that touch the spheres. Without them, the view is
        orthographic: a sphere has the same size everywhere.

    Raises
    ------
    EstimateError
        If the spheres do not agree.
    """
    size_px = np.array([image.outline.radius_px for image in images])
    if camera is None:
        sizes = radii_mm / size_px
    else:
        depths = [abs(cone.axis[2]) / cone.sine for cone in cones]
        sizes = radii_mm * np.array(depths) / camera.focal_px
    if sizes.max() > (1 + _MOST_APART) * sizes.min():
        raise EstimateError(
            f"by the spheres, a pixel is {sizes.min():.4g} to {sizes.max():.4g} mm: a radius is "
            "wrong, or an outline is not that of a sphere"
        )
    outline = np.array([image.systematic_px for image in images]) / size_px
    scatter = float(np.std(sizes, ddof=1)) / np.sqrt(len(sizes)) if len(sizes) > 1 else 0.0
    mean = float(sizes.mean())
    return mean, float(np.hypot(mean * outline.mean(), scatter))
