"""Positions of spheres of known radius, from their viewing cones."""

from __future__ import annotations

import numpy as np

from acquisition import CameraModel, DataError
from calibration._errors import EstimateError
from calibration.spheres.geometry.cone import Cone
from calibration.spheres.outline.sphere_image import SphereImage, places
from calibration.spheres.solve.joint_refinement import KnownSpheres
from rig import Notice, pluralize
from rig.arrays import Float64

# Spheres are placed near the working plane. If their computed distance from it exceeds this
# fraction of the working distance, the radius is probably wrong. A wrong radius also scales the
# positions of the lights, which no residual would show.
_FARTHEST_SHARE = 0.05
# A sphere whose height differs from that of the others by more than this share of the distance,
# and by four standard deviations, does not rest on the same plane. A pedestal of 5 mm appears as
# one of 12 mm, because what the sphere mirrors is farther away than supposed.
_OWN_SHARE, _SIGMAS = 0.01, 4.0
_SAME_SIZE = 0.08
# The border of what a sphere mirrors, mistaken for its outline, has 0.65 to 0.82 of its size.
_SMALLEST_SIZE = 0.85
# Share of the systematic variance of the radius that all outlines of a recording have in common:
# where the edge is within a blurred step. In rendered scenes, radii scatter by 0.02 px about a mean
# that is off by as much or more.
COMMON_SHARE = 0.5


def one_radius_each(
    radii: Float64,
    images: list[SphereImage],
    camera: CameraModel | None = None,
    *,
    found: bool,
    each: bool = True,
) -> Float64:
    """Return one radius for each sphere, in their order.

    If `found`, radii and spheres are sorted by size. If their numbers differ, or the radii are not
    one for `each` sphere, each sphere has the radius that fits its apparent size on the working
    plane, to 8 %.
    """
    if len(radii) == 1:
        return np.repeat(radii, len(images))
    if found and camera is not None and not (each and len(radii) == len(images)):
        sizes = np.array([radius_on_plane_mm(camera, image) for image in images])
        off = np.abs(sizes[:, None] / radii - 1)
        if off.min(axis=1).max() < _SAME_SIZE:
            return np.asarray(radii[np.argmin(off, axis=1)])
    if len(radii) != len(images):
        kind = EstimateError if found else DataError
        raise kind(
            f"{len(radii)} radii for {pluralize(len(images), 'sphere')}, {places(images)}: give "
            "one radius, or one for each sphere"
        )
    if found:
        order = np.argsort([image.outline.radius_px for image in images])
        radii = np.sort(radii)[np.argsort(order)]
    return radii


def radius_on_plane_mm(camera: CameraModel, image: SphereImage) -> float:
    """Return the radius of a sphere on the working plane with the apparent size of an image."""
    size = image.outline.radius_px
    return float(camera.centre_mm[2]) * size / (camera.focal_px + size)


def check_sizes(radii: Float64, images: list[SphereImage], camera: CameraModel) -> None:
    """Raise `EstimateError` if an outline is much too small for its sphere on the plane."""
    for image, radius in zip(images, radii, strict=True):
        share = radius_on_plane_mm(camera, image) / radius
        if share < _SMALLEST_SIZE:
            raise EstimateError(
                f"{places([image])} has the size of one of {share * radius:.1f} mm, not of "
                f"{radius:g} mm: its edge may be the border of what it mirrors: give a circle of "
                f"{image.outline.radius_px / share:.0f} px, a mask, or the right radius"
            )


def place(cones: list[Cone], radii: Float64, camera: CameraModel) -> KnownSpheres:
    """Return the spheres at the distances from the camera that follow from their radii."""
    eye = camera.centre_mm
    pairs = list(zip(cones, radii, strict=True))
    centres = np.array([eye + radius / cone.sine * cone.axis for cone, radius in pairs])
    common = np.concatenate([radius * common_error(cone, camera) for cone, radius in pairs])
    covariance = np.outer(common, common)
    for k, (cone, radius) in enumerate(pairs):
        own = slice(3 * k, 3 * k + 3)
        covariance[own, own] += radius**2 * (cone.covariance + systematic(cone, camera))
    return KnownSpheres(centres, radii, covariance)


def systematic(cone: Cone, camera: CameraModel) -> Float64:
    """Return the covariance of a centre in radii from systematic errors of its own outline.

    The scatter of the points does not include them: `Cone.systematic_px` of position and radius,
    without the part that all outlines have in common.
    """
    sideways = cone.systematic_px / camera.focal_px / cone.sine
    in_depth = _in_depth(cone, camera)
    covariance: Float64 = np.eye(3) * sideways**2
    return covariance + (1 - COMMON_SHARE) * np.outer(in_depth, in_depth)


def common_error(cone: Cone, camera: CameraModel) -> Float64:
    """Return the change ``(3,)`` of a centre in radii if all radii in the image err alike.

    The change belongs to one standard deviation, `COMMON_SHARE` of the variance of a radius.
    """
    return float(np.sqrt(COMMON_SHARE)) * _in_depth(cone, camera)


def _in_depth(cone: Cone, camera: CameraModel) -> Float64:
    """Return the change of a centre in radii if the outline is smaller by its systematic error."""
    sideways = cone.systematic_px / camera.focal_px / cone.sine
    return np.asarray(sideways * np.sqrt(1 - cone.sine**2) / cone.sine * cone.axis)


def off_the_plane(placed: KnownSpheres, camera: CameraModel) -> list[Notice]:
    """Return a warning if the radii place the spheres far from the working plane."""
    beneath_mm = float(np.median(placed.centres_mm[:, 2] - placed.radii_mm))
    if abs(beneath_mm) <= _FARTHEST_SHARE * camera.centre_mm[2]:
        return []
    text = (
        f"the radius places the spheres {abs(beneath_mm):.0f} mm "
        f"{'above' if beneath_mm > 0 else 'below'} the working plane: unless they are there, the "
        "radius or the working distance is wrong, and so are the positions of the lights"
    )
    return [Notice("spheres-off-the-plane", text)]


def one_off_the_plane(
    placed: KnownSpheres, camera: CameraModel, images: list[SphereImage]
) -> list[Notice]:
    """Return a warning about the sphere that is farthest above or below the others, if one is.

    Of two spheres, it is the upper one.
    """
    if len(images) < 2:
        return []
    heights = placed.centres_mm[:, 2] - placed.radii_mm
    variances = np.diag(placed.covariance_mm2)[2::3]
    others = [np.delete(np.arange(len(heights)), k) for k in range(len(heights))]
    above = [float(heights[k] - np.median(heights[rest])) for k, rest in enumerate(others)]
    worst = max(range(len(above)), key=lambda k: (round(abs(above[k]), 6), above[k]))
    sigma = float(np.sqrt(variances[worst] + np.median(variances[others[worst]])))
    if not abs(above[worst]) > max(_OWN_SHARE * camera.centre_mm[2], _SIGMAS * sigma):
        return []
    text = (
        f"its radius places {places([images[worst]])} {abs(above[worst]):.0f} +- {sigma:.0f} mm "
        f"{'above' if above[worst] > 0 else 'below'} the others: it has another radius, or does "
        "not rest on the working plane, and then its outline is wrong, too: lay it on the plane, "
        "check its radius, or leave it out"
    )
    return [Notice("sphere-off-the-plane", text)]
