"""Which round things in the images are the spheres that are meant: sharp, and of their size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel
from calibration._errors import EstimateError
from calibration._find_spheres import SphereImage, find_spheres, overlap, round_outlines
from calibration._sphere_images import places

# Outlines of spheres scatter by 0.02 to 0.15 px; those of what only looks round, by 0.4 and more.
_SHARP_OUTLINE_PX = 0.25
_SHARP_OUTLINE_RATIO = 3.0


def searched_spheres(
    values: npt.NDArray[np.float32],
    camera: CameraModel | None,
    radius_mm: float | Sequence[float] | None,
) -> tuple[list[SphereImage], list[str]]:
    """Find the spheres, those of the right size where camera and radius tell it.

    Parameters are those of `calibrate_spheres`.

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
    radii_px = _expected_radii_px(camera, radius_mm)
    images, blurred = _parted(find_spheres(values, radii_px))
    others: list[SphereImage] = []
    if radii_px:
        # A sphere of another size is not missed in silence, and a vague circle about it is not
        # taken for its outline. What a sphere mirrors may be the sharper circle, so both is said.
        parted, _ = _parted([*images, *find_spheres(values, beside=images)])
        others = [image for image in parted if image not in images]
    wanted = " or ".join(dict.fromkeys(f"{float(radius):g}" for radius in _lengths(radius_mm)))
    sizes = [f"{_radius_mm(camera, other):.1f}" for other in others if camera]
    if not images and others:
        raise EstimateError(
            f"no sphere of {wanted} mm found, but {places(others)} of about {', '.join(sizes)} mm: "
            "give each sphere's radius"
        )
    if not images:
        raise EstimateError(_nothing(values, radii_px))
    left_out = []
    if others:
        one = len(others) == 1
        left_out.append(
            f"{places(others)} {'was' if one else 'were'} left out: the sharp "
            f"{'outline' if one else 'outlines'} there {'fits' if one else 'fit'} about "
            f"{', '.join(sizes)} mm, not {wanted} mm: give each sphere's radius where they differ, "
            "else its circle or mask"
        )
    left_out += [
        f"{places([image])} was left out: its outline scatters by {image.rms_px:.1f} px, too much "
        "for a mirror sphere"
        for image in blurred
        if not any(overlap(image.outline, other.outline) for other in others)
    ]
    return images, left_out


def _parted(images: list[SphereImage]) -> tuple[list[SphereImage], list[SphereImage]]:
    """Return what is about as sharp as the sharpest outline, and what is far less so."""
    limit_px = _SHARP_OUTLINE_PX
    if images:
        limit_px = max(limit_px, _SHARP_OUTLINE_RATIO * min(image.rms_px for image in images))
    sharp = [image for image in images if image.rms_px <= limit_px]
    return sharp, [image for image in images if image.rms_px > limit_px]


def _nothing(values: npt.NDArray[np.float32], radii_px: Sequence[float]) -> str:
    sizes = ", ".join(f"{radius:.0f}" for radius in sorted(set(radii_px)))
    sized = f", {round_outlines(values, radii_px)} of them of a radius near {sizes} px"
    return (
        f"no mirror sphere found: {round_outlines(values)} round outlines in the mean image"
        f"{sized if sizes else ''}, none with a compact highlight that moves with the light; "
        f"{'check the radius, or ' if sizes else ''}give masks or circles"
    )


def _expected_radii_px(
    camera: CameraModel | None, radius_mm: float | Sequence[float] | None
) -> list[float]:
    """Return how large spheres that lie on the working plane appear."""
    if camera is None or camera.working_distance_mm is None or radius_mm is None:
        return []
    radii = _lengths(radius_mm)
    distances = np.maximum(camera.working_distance_mm - radii, radii)
    return [float(size) for size in _focal_px(camera) * radii / distances]


def _lengths(radius_mm: float | Sequence[float] | None) -> npt.NDArray[np.float64]:
    """Return one or several lengths as an array."""
    return np.atleast_1d(np.asarray([] if radius_mm is None else radius_mm, np.float64))


def _radius_mm(camera: CameraModel, image: SphereImage) -> float:
    """Return the radius of a sphere on the working plane that appears so large."""
    size = image.outline.radius_px
    return (camera.working_distance_mm or 0.0) * size / (_focal_px(camera) + size)


def _focal_px(camera: CameraModel) -> float:
    return float(np.sqrt(camera.K[0, 0] * camera.K[1, 1]))
