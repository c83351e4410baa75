"""Which round things in the images are the spheres that are meant: sharp, and of their size."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel
from calibration._errors import EstimateError
from calibration._spheres.find import find_spheres, overlap, round_outlines
from calibration._spheres.robust import Array
from calibration._spheres.sphere_image import SphereImage, places

# Outlines of spheres scatter by 0.02 to 0.15 px; those of what only looks round, by 0.4 and more.
_SHARP_OUTLINE_PX = 0.25
_SHARP_OUTLINE_RATIO = 3.0


def searched_spheres(
    values: npt.NDArray[np.float32],
    camera: CameraModel | None,
    radii_mm: Array | None,
) -> tuple[list[SphereImage], list[str]]:
    """Find the spheres, those of the right size where camera and radii tell it.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear, NaN where saturated.
    camera
        Camera of the images; with radii it has a working distance.
    radii_mm
        ``(1,)`` radius of all spheres, or one for each; None for any.

    Returns
    -------
    images
        At least one.
    left_out
        What was found and does not count, as its outline is far less sharp than that of the
        others, or its size is not that of any given radius; one line each, sizes in one.

    Raises
    ------
    EstimateError
        If none counts; the message says what was looked at.
    """
    if camera is None or radii_mm is None:
        images, blurred = _parted(find_spheres(values))
        if not images:
            raise EstimateError(
                f"no mirror sphere found: {round_outlines(values)} round outlines in the mean "
                "image, none with a compact highlight that moves with the light; give masks or "
                "circles"
            )
        return images, _blurred_lines(blurred)
    distances = np.maximum(camera.centre_mm[2] - radii_mm, radii_mm)
    radii_px = [float(size) for size in camera.focal_px * radii_mm / distances]
    images, blurred = _parted(find_spheres(values, radii_px))
    # A sphere of another size is not missed in silence, and a vague circle about it is not
    # taken for its outline. What a sphere mirrors may be the sharper circle, so both is said.
    parted, _ = _parted([*images, *find_spheres(values, beside=images)])
    others = [image for image in parted if image not in images]
    wanted = " or ".join(dict.fromkeys(f"{radius:g}" for radius in radii_mm))
    sizes = ", ".join(f"{_radius_mm(camera, other):.1f}" for other in others)
    if not images and others:
        raise EstimateError(
            f"no sphere of {wanted} mm found, but {places(others)} of about {sizes} mm: "
            "give each sphere's radius"
        )
    if not images:
        sizes_px = ", ".join(f"{radius:.0f}" for radius in sorted(set(radii_px)))
        raise EstimateError(
            f"no mirror sphere found: {round_outlines(values)} round outlines in the mean image, "
            f"{round_outlines(values, radii_px)} of them of a radius near {sizes_px} px, none with "
            "a compact highlight that moves with the light; check the radius, or give masks or "
            "circles"
        )
    left_out = []
    if others:
        one = len(others) == 1
        left_out.append(
            f"{places(others)} {'was' if one else 'were'} left out: the sharp "
            f"{'outline' if one else 'outlines'} there {'fits' if one else 'fit'} about "
            f"{sizes} mm, not {wanted} mm: give each sphere's radius where they differ, "
            "else its circle or mask"
        )
    unnamed = [b for b in blurred if not any(overlap(b.outline, o.outline) for o in others)]
    return images, left_out + _blurred_lines(unnamed)


def _parted(images: list[SphereImage]) -> tuple[list[SphereImage], list[SphereImage]]:
    """Return what is about as sharp as the sharpest outline, and what is far less so."""
    limit_px = _SHARP_OUTLINE_PX
    if images:
        limit_px = max(limit_px, _SHARP_OUTLINE_RATIO * min(image.rms_px for image in images))
    sharp = [image for image in images if image.rms_px <= limit_px]
    return sharp, [image for image in images if image.rms_px > limit_px]


def _blurred_lines(images: list[SphereImage]) -> list[str]:
    return [
        f"{places([image])} was left out: its outline scatters by {image.rms_px:.1f} px, too much "
        "for a mirror sphere"
        for image in images
    ]


def _radius_mm(camera: CameraModel, image: SphereImage) -> float:
    """Return the radius of a sphere on the working plane that appears so large."""
    size = image.outline.radius_px
    return float(camera.centre_mm[2]) * size / (camera.focal_px + size)
