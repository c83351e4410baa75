"""The outline of a sphere in a mask, compared with the outline that the images show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration._errors import EstimateError
from calibration._radiance.raw_stack import Images
from calibration._spheres.cone import OUTLINE_SIGMA_PX
from calibration._spheres.ellipse import Ellipse
from calibration._spheres.highlights import find_highlights
from calibration._spheres.near_circle import outline_near
from calibration._spheres.outline import OutlineImages
from calibration._spheres.outline_noise import circle_covariance
from calibration._spheres.painted import is_painted
from calibration._spheres.robust import Array
from calibration._spheres.sphere_image import SphereImage

# Errors of masks that are painted by hand, at least 3 px.
_REACH_PX, _REACH_SHARE = 3.0, 0.03
# The pixels of a mask are accurate to half a pixel: a smaller difference does not contradict it.
_SAME_PX = 0.5
# The 99.9 % quantile of chi-square with 3 degrees of freedom.
_SAME_OUTLINE = 16.3


def mask_reach_px(radius_px: float) -> float:
    """Return by how much the mask of a sphere may be wrong."""
    return max(_REACH_PX, _REACH_SHARE * radius_px)


def sphere_in_mask(
    values: Images,
    pictures: OutlineImages,
    mirroring: SphereImage | None,
    outline: Ellipse,
    points_px: Array,
    coverage: float,
) -> SphereImage:
    """Return the sphere in a mask, with the outline of the images if the mask contradicts them.

    The images show an outline if a ball that mirrors the plane is within 3 px or 3 % of the radius,
    or a sharp edge over 60 % of its length. A mask that differs from it by less than half a pixel,
    or by less than the errors of both, is kept, with the difference in its covariance if it is
    larger than the errors. A mask is also kept if the images show no outline there.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, NaN where saturated.
    pictures
        The same images, in which edges are searched for.
    mirroring
        The sphere near the mask that mirrors the plane; None without one.
    outline, points_px, coverage
        Outline of the mask, as for `SphereImage`.
    """
    highlights = find_highlights(values, outline)
    seen, mirrors = _seen_near(values, pictures, mirroring, outline)
    painted = not mirrors and is_painted(values, outline, highlights)
    given = SphereImage(outline, points_px, coverage, highlights, painted=painted)
    if seen is None:
        return replace(given, unconfirmed=True)
    change = np.array(
        [
            *np.subtract(seen.outline.centre_px, outline.centre_px),
            seen.outline.radius_px - outline.radius_px,
        ]
    )
    own = circle_covariance(points_px, outline)
    both = own + (
        circle_covariance(seen.points_px, seen.outline)
        if seen.covariance_px2 is None
        else seen.covariance_px2
    )
    if change @ np.linalg.solve(both, change) < _SAME_OUTLINE:
        return given
    if np.abs(change).max() < _SAME_PX:
        covariance = own - np.eye(3) * OUTLINE_SIGMA_PX**2 + np.outer(change, change)
        return replace(given, covariance_px2=covariance)
    return replace(seen, mask_off_px=float(np.abs(change).max()), painted=painted)


def _seen_near(
    values: Images,
    pictures: OutlineImages,
    mirroring: SphereImage | None,
    outline: Ellipse,
) -> tuple[SphereImage | None, bool]:
    """Return the sphere that the images show near an outline, without doubt, or None.

    The second result is whether it mirrors the plane.
    """
    radius = outline.radius_px
    reach = mask_reach_px(radius)
    seen = mirroring
    if seen is None:
        try:
            near = outline_near(pictures, outline, reach)
        except EstimateError:
            return None, False
        if not near.is_sharp:
            return None, False
        highlights = find_highlights(values, near.outline)
        seen = SphereImage(
            near.outline, near.points_px, near.coverage, highlights, near.covariance_px2
        )
    off = np.hypot(*np.subtract(seen.outline.centre_px, outline.centre_px))
    far = max(float(off), abs(seen.outline.radius_px - radius)) > 1.5 * reach
    return None if far else seen, mirroring is not None and not far
