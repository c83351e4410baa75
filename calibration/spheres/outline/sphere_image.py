"""Outline and highlights of one sphere in the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.spheres.geometry.cone import OUTLINE_SIGMA_PX
from calibration.spheres.highlights.highlights import Highlights
from calibration.spheres.outline.outline import TracedOutline
from rig import Notice, short_repr
from rig.arrays import Float64

# Below this share of visible outline, another circle nearby may fit as well.
SAFE_COVERAGE = 0.6
# Outlines of spheres scatter by 0.02 to 0.15 px, those of other round objects by 0.4 px or more.
_UNEVEN_PX = 0.4


@dataclass(frozen=True, eq=False)
class SphereImage(TracedOutline):
    """Outline and highlights of one sphere in the images.

    Parameters
    ----------
    outline
        The ellipse of its outline.
    points_px
        ``(M, 2)`` outline points.
    coverage
        Share 0..1 of the circumference that is visible.
    highlights
        Highlights, one per light.
    covariance_px2
        ``(3, 3)`` covariance of centre x, centre y and radius of the outline without the systematic
        error of ``systematic_px``, for a sphere that was seen to mirror the plane
        around it, which no other object does, for an outline near a given circle that is not
        sharp all around, or for a mask that the images contradict or do not confirm; else None, and
        the scatter of the points shows how well the outline is known.
    systematic_px
        Systematic error of centre x, centre y and radius, a part of which all outlines share.
    mask_off_px
        Largest difference of centre and radius from the given mask, if the images replaced it; 0
        otherwise.
    unconfirmed
        Whether it is in a mask whose outline the images do not confirm.
    painted
        Whether the sphere in a mask is shaded like a painted ball.
    on_plane
        Whether what it mirrors is, without doubt, a plane that faces the camera.
    scatter_px
        Robust scatter of the edge about the outline, NaN if no edge was found, where the points
        were computed from what the sphere mirrors; None where the points are those of the edge.
    """

    highlights: Highlights
    covariance_px2: Float64 | None = None
    systematic_px: float = OUTLINE_SIGMA_PX
    mask_off_px: float = 0.0
    unconfirmed: bool = False
    painted: bool = False
    on_plane: bool = False
    scatter_px: float | None = None

    __repr__ = short_repr

    @property
    def stated_px2(self) -> Float64:
        """The covariance of the outline, 0 if the scatter of the points shows it."""
        return np.zeros((3, 3)) if self.covariance_px2 is None else self.covariance_px2


def missing_highlights_warning(images: list[SphereImage]) -> list[Notice]:
    """Return a warning about spheres without any highlight, or an empty list."""
    dark = [image for image in images if not image.highlights.found.any()]
    if not dark:
        return []
    text = (
        f"no highlight under any light on {places(dark)}, which is ignored: check that it is a "
        "mirror sphere and that its outline is correct"
    )
    return [Notice("sphere-without-highlight", text)]


def saturation_warning(images: list[SphereImage]) -> list[Notice]:
    """Return a warning about saturated highlights, or an empty list."""
    share = np.mean(
        np.concatenate([image.highlights.saturated[image.highlights.found] for image in images])
    )
    if share == 0:
        return []
    text = (
        f"{100 * share:.0f} % of the highlights are saturated, so their directions may be wrong by "
        "a degree: add a short exposure"
    )
    return [Notice("highlights-saturated", text)]


def partial_outline_warning(images: list[SphereImage], size: tuple[int, int]) -> list[Notice]:
    """Return warnings about spheres whose outline is mostly hidden or faint, or an empty list.

    ``size`` is the height and width of the images. Where the frame cuts off a sphere, and its
    outline is visible inside of it, the advice is another one.
    """
    doubtful = [image for image in images if image.coverage < SAFE_COVERAGE]
    cut = [image for image in doubtful if image.coverage >= SAFE_COVERAGE * _inside(image, size)]
    hidden = [image for image in doubtful if image not in cut]
    advice = "light the background, give a mask, or give circles"
    reasons = ((hidden, "", advice), (cut, ", because the frame cuts it off", "move it inside"))
    return [
        Notice(
            "outline-partly-seen",
            f"the outline of {places(some)} is visible over only {_shares(some)} of its length"
            f"{reason}, so it may be misplaced: {remedy}",
        )
        for some, reason, remedy in reasons
        if some
    ]


def _shares(images: list[SphereImage]) -> str:
    return ", ".join(f"{100 * image.coverage:.0f} %" for image in images)


def _inside(image: SphereImage, size: tuple[int, int]) -> float:
    """Return the share 0..1 of an outline that is inside of the frame."""
    points = image.outline.point(np.arange(360) * np.pi / 180)
    return float(np.mean(np.all((points >= 0) & (points <= np.array(size[::-1]) - 1), axis=1)))


def uneven_outline_warning(images: list[SphereImage]) -> list[Notice]:
    """Return a warning about spheres whose outline is not sharp, or an empty list."""
    uneven = [image for image in images if image.rms_px > _UNEVEN_PX]
    if not uneven:
        return []
    scatter = ", ".join(f"{image.rms_px:.1f} px" for image in uneven)
    text = (
        f"the outline of {places(uneven)} scatters by {scatter}, so it may be misplaced: light the "
        "background evenly, or give a mask"
    )
    return [Notice("outline-uneven", text)]


def mask_warnings(images: list[SphereImage]) -> list[Notice]:
    """Return notices about masks that contradict the images or show painted balls."""
    notices = [
        Notice(
            "mask-refined",
            f"the mask of {places([image])} is off by {image.mask_off_px:.1f} px: the outline in "
            "the images is used",
            severity="info",
        )
        for image in images
        if image.mask_off_px
    ]
    alone = [image for image in images if image.unconfirmed]
    if alone:
        # A highlight that is a share of the radius off turns the light by twice that angle.
        degrees, sigma = max(_error_of_outline(image) for image in alone)
        text = (
            f"the images do not confirm the outline of the mask of {places(alone)}, so its stated "
            f"error is that of painted masks, {sigma:.1f} px, by which the lights are off by "
            f"{degrees:.1f} degrees; compare it with the images in lights.png"
        )
        notices.append(Notice("mask-unconfirmed", text))
    painted = [image for image in images if image.painted]
    if painted:
        text = (
            f"{places(painted)} is shaded like a painted ball, so its highlights are not those of "
            "a mirror: check the mask"
        )
        notices.append(Notice("sphere-painted", text))
    return notices


def _error_of_outline(image: SphereImage) -> tuple[float, float]:
    """Return the standard deviation of an outline in degrees of a light, and in px."""
    sigma_px = float(np.sqrt(np.trace(image.stated_px2) / 3))
    return float(np.degrees(2 * sigma_px / image.outline.radius_px)), sigma_px


def places(images: list[SphereImage]) -> str:
    """Return a text that names spheres by their positions in the image."""
    where = [f"({i.outline.centre_px[0]:.0f}, {i.outline.centre_px[1]:.0f})" for i in images]
    return ("the sphere at " if len(where) == 1 else "the spheres at ") + ", ".join(where) + " px"


def circles_of(images: Sequence[SphereImage]) -> tuple[tuple[float, float, float], ...]:
    """Return the circles (x, y, radius) of spheres in pixels."""
    return tuple(image.outline.circle_px for image in images)
