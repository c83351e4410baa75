"""Selection of the spheres among round outlines, by sharpness and size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from acquisition import CameraModel
from calibration._errors import EstimateError
from calibration._radiance.raw_stack import Images
from calibration._spheres.edge_search import overlap, round_outlines
from calibration._spheres.find import find_spheres
from calibration._spheres.frame_cut import cut_spheres
from calibration._spheres.outline import SHARP_PX
from calibration._spheres.placed import radius_on_plane_mm
from calibration._spheres.robust import Array
from calibration._spheres.sphere_image import SphereImage, circles_of, places
from calibration._spheres.spots import ReducedStack, reduce_stack, spot_clusters
from rig import Notice, pluralize

_SHARP_OUTLINE_RATIO = 3.0


def searched_spheres(
    values: Images,
    camera: CameraModel | None,
    radii_mm: Array | None,
) -> tuple[list[SphereImage], list[Notice]]:
    """Search for the spheres; with a camera and radii, only for spheres of the right size.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, NaN where saturated.
    camera
        Camera of the images; it must have a working distance if there are radii.
    radii_mm
        ``(1,)`` radius of all spheres, or one radius for each; None for any size.

    Returns
    -------
    images
        At least one sphere.
    left_out
        Notices about outlines that do not count, because they are much less sharp than the others
        or do not have the size of any radius; one for each, wrong sizes in one.

    Raises
    ------
    EstimateError
        If no sphere counts; the message describes the candidates.
    """
    reduced = reduce_stack(values)
    if camera is None or radii_mm is None:
        images, blurred = _parted(find_spheres(values, camera=camera, reduced=reduced))
        if not images:
            raise EstimateError(
                f"no mirror sphere found: {_shown(reduced, values)} give masks or circles"
            )
        return images, _left_out(reduced, images, blurred)
    distances = np.maximum(camera.centre_mm[2] - radii_mm, radii_mm)
    radii_px = [float(size) for size in camera.focal_px * radii_mm / distances]
    images, blurred = _parted(find_spheres(values, radii_px, camera=camera, reduced=reduced))
    # Report spheres of another size, and do not take a blurred circle around them for the outline.
    # A mirrored circle may be sharper than the outline, so the message suggests both remedies.
    more = find_spheres(values, excluded=images, camera=camera, reduced=reduced)
    parted, _ = _parted([*images, *more])
    others = [image for image in parted if image not in images]
    wanted = " or ".join(dict.fromkeys(f"{radius:g}" for radius in radii_mm))
    sizes = ", ".join(f"{radius_on_plane_mm(camera, other):.1f}" for other in others)
    if not images and others:
        error = EstimateError(
            f"no sphere of {wanted} mm found, but {places(others)} of about {sizes} mm: "
            "give the radius of each sphere"
        )
        error.spheres = circles_of(others)
        raise error
    if not images:
        shown = _shown(reduced, values, radii_px)
        raise EstimateError(
            f"no mirror sphere found: {shown} check the radius, or give masks or circles"
        )
    left_out = []
    if others:
        one = len(others) == 1
        text = (
            f"{places(others)} {'was' if one else 'were'} left out: the sharp "
            f"{'outline' if one else 'outlines'} there {'fits' if one else 'fit'} about "
            f"{sizes} mm, not {wanted} mm: give the radius of each sphere if they differ, "
            "otherwise circles or masks"
        )
        left_out.append(Notice("sphere-of-another-size", text))
    unnamed = [b for b in blurred if not any(overlap(b.outline, o.outline) for o in others)]
    return images, left_out + _left_out(reduced, [*images, *others], unnamed)


def _shown(reduced: ReducedStack, values: Images, radii_px: Sequence[float] = ()) -> str:
    """Return what images without a sphere show, and what may help."""
    sizes = ", ".join(f"{radius:.0f}" for radius in sorted(set(radii_px)))
    clusters = spot_clusters(reduced)
    if clusters:
        x, y = clusters[0].centre_px
        size = f" with a radius near {sizes} px" if sizes else ""
        return (
            f"bright spots move with the light near ({x:.0f}, {y:.0f}) px, but most images show no "
            f"outline of a mirror sphere{size} around them: light the background evenly, or"
        )
    count = f"{pluralize(round_outlines(values), 'round outline')} in the mean image, "
    if sizes:
        count += f"{round_outlines(values, radii_px)} of them with a radius near {sizes} px, "
    return f"{count}none with a compact highlight that moves with the light:"


def _parted(images: list[SphereImage]) -> tuple[list[SphereImage], list[SphereImage]]:
    """Return spheres that mirror a plane or have sharp outlines, and much less sharp outlines."""
    limit_px = SHARP_PX
    if images:
        limit_px = max(limit_px, _SHARP_OUTLINE_RATIO * min(image.rms_px for image in images))
    sharp = [
        image for image in images if image.covariance_px2 is not None or image.rms_px <= limit_px
    ]
    return sharp, [image for image in images if image not in sharp]


def _left_out(
    reduced: ReducedStack, found: list[SphereImage], blurred: list[SphereImage]
) -> list[Notice]:
    return [*_blurred_notices(blurred), *cut_spheres(reduced, [*found, *blurred])]


def _blurred_notices(images: list[SphereImage]) -> list[Notice]:
    return [
        Notice(
            "sphere-blurred",
            f"{places([image])} was left out: the outline scatters by {image.rms_px:.1f} px, too "
            "much for a mirror sphere",
        )
        for image in images
    ]
