"""Outlines of spheres, confirmed or replaced by the edges of all images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.radiance.stack import Images
from calibration.spheres.geometry.ellipse import Ellipse
from calibration.spheres.highlights.highlights import find_highlights
from calibration.spheres.outline.joint_search import (
    FACTORS,
    JointNear,
    OutlinesNear,
    best_of,
    edges_agree,
    edges_support,
    joint_near,
)
from calibration.spheres.outline.mirror_outline import outlined_mirror
from calibration.spheres.outline.mirror_search import mirror_near
from calibration.spheres.outline.outline import usual_reach_px
from calibration.spheres.outline.outline_noise import SAME_OUTLINE, chi_square
from calibration.spheres.outline.sphere_image import SphereImage
from calibration.spheres.outline.surroundings import MirroredPlane
from rig.arrays import Float64

# One picture may show an edge as far from the outline that less of all images supports.
_WIDER_SHARE, _DECIDED = 0.1, 0.5
# It may show the border of what a larger ball mirrors: sizes of balls around it, in its radii.
_AROUND, _AROUND_REACH = 1.2, 0.25
# Images are compared down to this part of the size, and to that in which edges are seen.
_USUAL_FACTOR = 4
# Circles that are given may be so many times their reach away.
_NEAR = 2.0
# A ball mirrors the horizon at this share of its radius, known to a reach in radii of the ball.
HORIZON = 0.73
_HORIZON_REACH = 0.15
# Without a plane, only the edges show that there is a ball. False outlines have up to 0.48, all of
# those below 0.6 get a notice.
LEAST_SUPPORT = 0.45
# Noise supports up to a quarter: an outline with less on its bright side is not seen there.
_NOT_SEEN = 0.25
# Contact shadows and what is mirrored at the limb move the edges of all images by up to 0.2 px.
_MODEL_PX = 0.15
# Edges that determine the outline less well, as a share of the radius, contradict nothing.
_WELL_KNOWN = 0.03


def confirmed(values: Images, mirroring: Sequence[SphereImage]) -> list[SphereImage | None]:
    """Return spheres that seem to mirror the plane, with outlines that the edges confirm.

    The mirror image determines an outline if the sphere rests on a plane that faces the camera.
    Where there is no such plane, something else is compared, and the outline is wrong. The edges of
    all images do not depend on the plane. If they confirm the outline of one sphere, the plane is
    there, and all spheres are returned as they are. So they are if the edges do not determine an
    outline well enough to contradict that of one of several spheres, which confirm each other. A
    single sphere may have either outline then, unless the plane itself is without doubt and edges
    support the outline on it: its covariance contains the difference. Otherwise, each sphere gets
    the outline of the edges. Where less than half of its length is supported, its covariance
    contains the difference.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, NaN where saturated.
    mirroring
        Spheres with the covariances of their outlines.

    Returns
    -------
    list of SphereImage or None
        None for a sphere around which the edges of all images support no outline.
    """
    by_edges: list[SphereImage | None] = []
    for sphere in mirroring:
        if edges_agree(values, sphere.outline):
            return list(mirroring)
        joint = best_of(found_near(values, sphere.outline))
        if joint is None:
            by_edges.append(None)
            continue
        change = sphere.outline.change_to(joint.outline)
        if not _contradicts(joint, sphere, change):
            several = len(mirroring) > 1
            return list(mirroring) if several else [_either(values, sphere, joint, change)]
        doubt = 0.0 if joint.support >= _DECIDED else 1.0
        by_edges.append(_with_outline(values, sphere, joint, doubt * np.outer(change, change)))
    return by_edges


def confirmed_near(
    values: Images, plane: MirroredPlane, circles: Sequence[Ellipse], reaches_px: Sequence[float]
) -> list[SphereImage | None]:
    """Return the spheres near circles that mirror the plane, see `mirror_near` and `confirmed`.

    None for a circle near which no ball mirrors the plane, or where the edges do not confirm it
    within twice the reach.
    """
    found = [
        mirror_near(plane, circle, reach) for circle, reach in zip(circles, reaches_px, strict=True)
    ]
    spheres = confirmed(values, [outlined_mirror(values, plane, one) for one in found if one])
    left = iter(spheres)
    near: list[SphereImage | None] = []
    for circle, reach, mirror in zip(circles, reaches_px, found, strict=True):
        sphere = next(left) if mirror else None
        far = sphere and np.abs(circle.change_to(sphere.outline)).max() > _NEAR * reach
        near.append(None if far else sphere)
    return near


def ball_around(values: Images, plane: MirroredPlane, edge: Ellipse) -> SphereImage | None:
    """Return the ball in which an edge is the mirrored horizon, or None.

    It is around the edge, of the size that belongs to it, and mirrors the plane.
    """
    x, y, radius = edge.circle_px
    ball = Ellipse.circle(x, y, radius / HORIZON)
    return confirmed_near(values, plane, [ball], [_HORIZON_REACH * ball.radius_px])[0]


def in_all_images(values: Images, sphere: SphereImage) -> SphereImage | None:
    """Return a sphere with the outline that the edges of most images support.

    An edge of one picture may be the border of what a ball mirrors. So, if less than half of the
    outline is supported, outlines around it are compared as well, up to 1.45 times as large. None
    if less than 45 % of the best one is supported. Outlines that are not seen where their
    surroundings are bright do not count.
    """
    found = [one for one in found_near(values, sphere.outline) if not is_border(one)]
    if max((one.support for one in found), default=0.0) < _DECIDED:
        size = sphere.outline.radius_px
        around = Ellipse.circle(*sphere.outline.centre_px, _AROUND * size)
        least = found[0].factor if found else 1
        larger = joint_near(values, around, _AROUND_REACH * size, _factors(found[:1], least))
        found += [] if larger is None or is_border(larger) else [larger]
    joint = best_of(found)
    if joint is None or joint.support < LEAST_SUPPORT:
        return None
    return _with_outline(values, sphere, joint, np.zeros((3, 3)))


def is_border(one: JointNear) -> bool:
    """Return whether an outline is the border of what a ball mirrors: black surroundings."""
    return one.bright_support < _NOT_SEEN


def found_near(values: Images, outline: Ellipse) -> list[JointNear]:
    """Return outlines near another one that the edges of all images support, one or two."""
    radius = outline.radius_px
    near = OutlinesNear(values, outline)
    joint = near.within(usual_reach_px(radius))
    found = [] if joint is None else [joint]
    if joint is None or joint.support < _DECIDED:
        wider = near.within(usual_reach_px(radius, _WIDER_SHARE), _factors(found))
        found += [] if wider is None else [wider]
    return found


def _factors(found: Sequence[JointNear], least: int = 1) -> list[int]:
    """Return how many times smaller images may be that show edges near those that were found."""
    most = max([_USUAL_FACTOR, *(one.factor for one in found)]) if found else FACTORS[-1]
    return [factor for factor in FACTORS if least <= factor <= most]


def _contradicts(joint: JointNear, sphere: SphereImage, change: Float64) -> bool:
    """Return whether the edges of all images differ from an outline by more than both errors."""
    covariance = joint.covariance_px2
    limit_px = _WELL_KNOWN * sphere.outline.radius_px
    if np.linalg.eigvalsh(covariance)[-1] > limit_px**2:
        return False
    both = covariance + sphere.stated_px2 + np.eye(3) * (_MODEL_PX**2 + sphere.systematic_px**2)
    return chi_square(change, both) > SAME_OUTLINE


def _either(values: Images, sphere: SphereImage, joint: JointNear, change: Float64) -> SphereImage:
    """Return a sphere that may have its own outline or that of the edges.

    Of spheres on print, edges support 0.39 to 0.78 of the length of their outlines.
    """
    if sphere.on_plane and edges_support(values, sphere.outline):
        return sphere
    covariance = sphere.stated_px2 + joint.covariance_px2 + np.eye(3) * joint.model_px**2
    return replace(
        sphere,
        coverage=min(sphere.coverage, joint.support),
        covariance_px2=covariance + np.outer(change, change),
    )


def _with_outline(
    values: Images, sphere: SphereImage, joint: JointNear, doubt_px2: Float64
) -> SphereImage | None:
    """Return a sphere with another outline, None if it shows fewer highlights in it."""
    highlights = find_highlights(values, joint.outline)
    if np.count_nonzero(highlights.found) < np.count_nonzero(sphere.highlights.found):
        return None
    covariance = joint.covariance_px2 + np.eye(3) * joint.model_px**2 + doubt_px2
    return SphereImage(joint.outline, joint.points_px, joint.support, highlights, covariance)
