"""Where spheres of known radius lie, from the cones in which the camera sees them."""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

from acquisition import CameraModel, DataError
from calibration._errors import EstimateError
from calibration._spheres.cone import Cone
from calibration._spheres.light_positions import KnownSpheres
from calibration._spheres.robust import Array
from calibration._spheres.sphere_image import SphereImage, places

_OUTLINE_SIGMA_PX = 0.05
# Spheres lie about the working plane: farther off by this share of its distance, the radius that
# was given puts them there. It would scale the lights' positions alike, and no residual would tell.
_FARTHEST_SHARE = 0.05


def one_radius_each(radii: Array, images: list[SphereImage], *, found: bool) -> Array:
    """Return one radius for each sphere, in their order; of found ones the larger look larger."""
    if len(radii) == 1:
        return np.repeat(radii, len(images))
    if found and len(radii) != len(images):
        raise EstimateError(
            f"{len(images)} spheres found for {len(radii)} radii, {places(images)}: "
            "give one radius for each, or masks or circles"
        )
    if len(radii) != len(images):
        raise DataError(f"{len(radii)} radii for {len(images)} spheres: give one, or one for each")
    if found:
        order = np.argsort([image.outline.radius_px for image in images])
        radii = np.sort(radii)[np.argsort(order)]
    return radii


def place(cones: list[Cone], radii: Array, camera: CameraModel) -> KnownSpheres:
    """Put each sphere as far from the camera as its radius says."""
    eye = camera.centre_mm
    pairs = list(zip(cones, radii, strict=True))
    centres = np.array([eye + radius / cone.sine * cone.axis for cone, radius in pairs])
    # The scatter of the points does not tell how far an outline is off as a whole.
    pixel_angle = _OUTLINE_SIGMA_PX / camera.focal_px
    covariances = []
    for cone, radius in pairs:
        sideways = pixel_angle * radius / cone.sine
        in_depth = sideways * np.sqrt(1 - cone.sine**2) / cone.sine * cone.axis
        systematic = np.eye(3) * sideways**2 + np.outer(in_depth, in_depth)
        covariances.append(radius**2 * cone.covariance + systematic)
    return KnownSpheres(centres, radii, block_diag(*covariances))


def off_the_plane(known: KnownSpheres, camera: CameraModel) -> list[str]:
    """Tell of spheres that their radii put far from the working plane."""
    beneath_mm = float(np.median(known.centres_mm[:, 2] - known.radii_mm))
    if abs(beneath_mm) <= _FARTHEST_SHARE * camera.centre_mm[2]:
        return []
    return [
        f"the radius puts the spheres {abs(beneath_mm):.0f} mm "
        f"{'above' if beneath_mm > 0 else 'below'} the working plane: unless they lie there, "
        f"radius or working distance is wrong, and the lights' positions with it"
    ]
