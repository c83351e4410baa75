"""The outline near a given circle, and how far away another one fits the edges as well."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration._errors import EstimateError, or_none
from calibration.spheres.geometry.ellipse import Ellipse
from calibration.spheres.outline.facing_edges import EdgesAround
from calibration.spheres.outline.joint_search import (
    WITHOUT_DOUBT,
    JointNear,
    best_of,
    joint_near,
    with_others,
)
from calibration.spheres.outline.mirrored_border import is_mirrored_border
from calibration.spheres.outline.outline import (
    SHARP_PX,
    OutlineImages,
    TracedOutline,
    no_outline,
    refine_outline,
    refine_sharpest,
)
from calibration.spheres.outline.outline_confirmation import LEAST_SUPPORT, found_near, is_border
from calibration.spheres.outline.outline_noise import scatter_covariance
from calibration.spheres.outline.sphere_image import SAFE_COVERAGE
from rig.arrays import Float64

# Outlines with a smaller ratio of the axes are compared with circles.
_ROUND = 0.99
# Edges of print agree with some circle over up to a quarter of its length.
_LEAST_IN_PICTURE = 0.3
# Outlines that are farther away than stated reach are compared as well.
_WIDER = 2.0
# Edge points along this length of an outline count as one observation.
_INDEPENDENT_PX = 8.0
# Where a ball is, in multiples of the radius of a horizon that is mirrored in it.
_OUTER, _OUTER_REACH = 1.38, 0.2
_OUTER_COVERAGE, _OUTER_SCATTER_PX = 0.35, 0.4
_INNER, _OUTER_SUPPORT = 0.93, 0.25
# With a larger error of its outline, in radii, a ball shows directions only to 2 degrees or worse.
_LARGEST_SIGMA = 0.02


@dataclass(frozen=True, eq=False)
class NearOutline(TracedOutline):
    """An outline near a circle.

    Parameters
    ----------
    covariance_px2
        ``(3, 3)`` covariance of centre x, centre y and radius without systematic errors, which
        includes the other outlines that the edges support; None if the scatter of the points
        shows how well it is known.
    is_sharp
        Whether one picture shows a sharp outline over 60 % of its length, which is beyond doubt.
    """

    covariance_px2: Float64 | None
    is_sharp: bool = False

    @property
    def sigma_px(self) -> float:
        """Largest standard deviation of centre and radius along any direction."""
        if self.covariance_px2 is None:
            return 0.0
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance_px2)[-1]))


_Found = tuple[float, TracedOutline]


def outline_near(pictures: OutlineImages, circle: Ellipse, reach_px: float) -> NearOutline:
    """Return the outline near a circle that most edges support.

    If the nearest edges form a sharp outline over 60 % of its length, this is the outline. Else all
    circles whose centre and radius differ by up to twice the reach are compared by the share of
    their circumference where an edge faces them, not by the strength of the edges. The best eight
    are refined. One that has n observations less than the best one (8 px of circumference each) is
    exp(-n) times as plausible; the covariance of this mixture adds to that of the best outline, so
    that it contains the others if the edges do not decide. At last, the edges of all images decide
    together, see `joint_near`: also if one picture is too noisy to show a sharp outline. If neither
    is without doubt, the covariance contains what the edges without support may show.

    Parameters
    ----------
    pictures
        The images in which edges are searched for.
    circle
        The approximate outline.
    reach_px
        Largest error of its centre and of its radius.

    Raises
    ------
    EstimateError
        If there is no edge near the circle, if the edges do not determine the outline to 2 % of the
        radius, or if another outline around it shows that it may be the mirrored horizon.
    """
    trials = []
    first = or_none(refine_sharpest, pictures, circle, reach_px)
    if first is not None:
        if _is_sharp(first) and _farthest(circle, first.outline) <= _WIDER * reach_px:
            _check_inside(pictures, first)
            sharp = NearOutline(first.outline, first.points_px, first.coverage, None, is_sharp=True)
            joints = [joint_near(pictures.values, sharp.outline, 3.0)]
            if min(sharp.outline.semi_axes_px) < _ROUND * max(sharp.outline.semi_axes_px):
                # An ellipse agrees with more edges than a circle does, also where it is wrong.
                joints += found_near(pictures.values, circle)
            return _decided(sharp, best_of([joint for joint in joints if joint]))
        trials.append(first.outline)
    found: list[_Found] = []
    for picture in (pictures.upper, pictures.median):
        edges = EdgesAround([picture], circle, _WIDER * reach_px)
        for trial in [*trials, *edges.leaders()]:
            refined = or_none(refine_outline, picture, trial, 3.0)
            if refined and _farthest(circle, refined.outline) <= 1.2 * _WIDER * reach_px:
                found.append((_support(refined), refined))
    if not found:
        raise no_outline(circle)
    even = [one for one in found if one[1].rms_px < SHARP_PX]
    best = _mixture(_outermost(even or found), circle, reach_px)
    doubtful = not best.rms_px < SHARP_PX or _support(best) < _LEAST_IN_PICTURE
    doubtful |= best.sigma_px > _LARGEST_SIGMA * best.outline.radius_px
    joint = joint_near(pictures.values, best.outline, reach_px)
    if doubtful:
        # The outline in one picture may be farther away than the circle.
        joint = best_of([*found_near(pictures.values, circle), *([joint] if joint else [])])
        if joint is None or not _is_clear(joint, circle, reach_px):
            x, y, radius = circle.circle_px
            raise EstimateError(
                f"the edges near the circle ({x:.0f}, {y:.0f}, {radius:.0f}) px do not determine "
                f"the outline of a sphere: the best one is visible over {100 * best.coverage:.0f} "
                f"% of its length, scatters by {best.rms_px:.1f} px and is known to "
                f"{best.sigma_px:.1f} px: give a better circle or a mask, or light the background "
                "evenly"
            )
    best = _decided(best, joint, doubtful=doubtful)
    _check_inside(pictures, best)
    return best


def _is_clear(joint: JointNear, circle: Ellipse, reach_px: float) -> bool:
    """Return whether the edges of all images determine an outline that one picture does not."""
    sigma_px = np.sqrt(np.linalg.eigvalsh(joint.covariance_px2)[-1] + joint.model_px**2)
    return bool(
        joint.support >= LEAST_SUPPORT
        and not is_border(joint)
        and sigma_px <= _LARGEST_SIGMA * joint.outline.radius_px
        and _farthest(circle, joint.outline) <= 1.2 * _WIDER * reach_px
    )


def _decided(near: NearOutline, joint: JointNear | None, *, doubtful: bool = False) -> NearOutline:
    """Return the outline that the edges of most images support, if there is one."""
    if joint is None:
        return near
    covariance = joint.covariance_px2
    if doubtful or (joint.support < WITHOUT_DOUBT and not near.is_sharp):
        covariance = covariance + np.eye(3) * joint.model_px**2
    return NearOutline(joint.outline, joint.points_px, joint.coverage, covariance, near.is_sharp)


def _is_sharp(found: TracedOutline) -> bool:
    """Return whether an outline is sharp and visible over most of its length."""
    return found.coverage >= SAFE_COVERAGE and found.rms_px < SHARP_PX


def _check_inside(pictures: OutlineImages, found: TracedOutline) -> None:
    """Raise `EstimateError` if an outline may be the horizon that is mirrored in a ball.

    It is mirrored at about 73 % of the radius, as a circle with nearly the same centre; what is
    inside of it does not vary like what is outside.
    """
    outline = found.outline
    x, y, radius = outline.circle_px
    if is_mirrored_border(pictures.median, outline, mostly_seen=found.coverage >= SAFE_COVERAGE):
        raise EstimateError(
            f"the edge at ({x:.0f}, {y:.0f}, {radius:.0f}) px may be the border of what a larger "
            "sphere mirrors: what is just inside of it does not vary like what is just outside: "
            "give a circle closer to the outline, or a mask"
        )
    around = Ellipse.circle(x, y, _OUTER * radius)
    edges = EdgesAround([pictures.upper], around, _OUTER_REACH * radius)
    for trial in edges.leaders():
        if edges.support(trial) < 0.5 * _OUTER_COVERAGE:
            continue
        other = or_none(refine_outline, pictures.upper, trial, 3.0)
        if other is None:
            continue
        x2, y2, radius2 = other.outline.circle_px
        apart = max(0.5 * (_OUTER - 1) * radius, 2 * outline.apart_px(other.outline))
        seen = other.coverage > _OUTER_COVERAGE and other.rms_px < _OUTER_SCATTER_PX
        if seen and radius2 - radius > apart:
            raise EstimateError(
                f"the edge at ({x:.0f}, {y:.0f}, {radius:.0f}) px may be the horizon that a larger "
                f"sphere mirrors, with its outline at ({x2:.0f}, {y2:.0f}, "
                f"{radius2:.0f}) px: give that circle, or a mask"
            )


def _support(found: TracedOutline) -> float:
    """Return the share of the circumference where edges agree with an outline."""
    distances = found.outline.distance_px(found.points_px) / SHARP_PX
    return found.coverage * float(np.mean(1 / (1 + distances**2)))


def _outermost(found: list[_Found]) -> list[_Found]:
    """Return the outlines without those that another one may mirror.

    A ball mirrors circles inside itself, sharper ones than its outline among them, but no circle
    around itself.
    """

    def mirrors(outer: _Found, inner: _Found) -> bool:
        large, small = outer[1].outline, inner[1].outline
        is_inside = small.apart_px(large) + small.radius_px < large.radius_px
        smaller = small.radius_px < _INNER * large.radius_px
        return smaller and is_inside and outer[0] > max(_OUTER_SUPPORT, 0.5 * inner[0])

    return [inner for inner in found if not any(mirrors(outer, inner) for outer in found)]


def _mixture(found: list[_Found], circle: Ellipse, reach_px: float) -> NearOutline:
    """Return the best of the outlines, of those that are equally good the one near the circle."""
    logs = [
        2 * np.pi * circle.radius_px / _INDEPENDENT_PX * support
        - 0.5 * float(np.sum((circle.change_to(one.outline) / reach_px) ** 2))
        for support, one in found
    ]
    order = np.argsort(-np.array(logs), kind="stable")
    best = found[order[0]][1]
    # The fit selects the points that agree with it: over a part of the outline, their scatter
    # shows too small an error.
    covariance = scatter_covariance(best) + np.eye(3) * 0.5 * best.rms_px**2
    changes = [best.outline.change_to(found[index][1].outline) for index in order]
    less = [logs[index] - logs[order[0]] for index in order]
    covariance = with_others(covariance, changes, less)
    return NearOutline(best.outline, best.points_px, best.coverage, covariance)


def _farthest(a: Ellipse, b: Ellipse) -> float:
    """Return the largest change from one outline to another."""
    return float(np.abs(a.change_to(b)).max())
