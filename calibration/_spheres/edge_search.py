"""Search for mirror spheres by round edges that contain a moving highlight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration._errors import EstimateError
from calibration._radiance.raw_stack import Images
from calibration._spheres.ellipse import Ellipse
from calibration._spheres.highlights import find_highlights
from calibration._spheres.outline import (
    SHARP_PX,
    OutlineImages,
    outline_image,
    refine_sharpest,
    scatter_px,
)
from calibration._spheres.painted import is_painted
from calibration._spheres.robust import Array
from calibration._spheres.round_edges import LEAST_COVERAGE, circular_edges
from calibration._spheres.sphere_image import SphereImage
from calibration._spheres.spots import SpotCluster

_CANDIDATES = 120
_REACH_PX, _REACH_SHARE = 3.0, 0.03
_FEW = 8


def spheres_by_edges(
    values: Images,
    clusters: Sequence[SpotCluster],
    radii_px: Sequence[float],
    known: Sequence[SphereImage],
) -> list[SphereImage]:
    """Find spheres around clusters of highlights by the round edges of the mean image.

    The first of overlapping outlines is kept, unless it is not sharp and a later one is.
    """
    pictures = OutlineImages(values)
    circles = [circle for circle in circular_edges(pictures.upper) if expected(circle, radii_px)]
    spheres: list[SphereImage] = []
    for circle in circles[:_CANDIDATES]:
        if not any(inside(cluster, circle) for cluster in clusters):
            continue
        sharp = [sphere for sphere in spheres if sphere.rms_px < SHARP_PX]
        if rivals_of(circle, [*known, *sharp]):
            continue
        rivals = rivals_of(circle, spheres)
        edge = _refined(pictures, circle, [sphere.outline for sphere in rivals])
        if edge is None or not expected(edge[0], radii_px) or rivals_of(edge[0], known):
            continue
        # What is slower is checked last: most circles around a ball are mirrored in it.
        if not rivals and not _has_highlights(values, circle):
            continue
        rivals = rivals_of(edge[0], spheres)
        if not all(scatter_px(*edge[:2]) < SHARP_PX < rival.rms_px for rival in rivals):
            continue
        sphere = mirroring(values, *edge)
        if sphere is not None:
            spheres = [other for other in spheres if other not in rivals] + [sphere]
    return spheres


def rivals_of(outline: Ellipse, spheres: Sequence[SphereImage]) -> list[SphereImage]:
    """Return the spheres that overlap an outline."""
    return [sphere for sphere in spheres if overlap(outline, sphere.outline)]


def inside(cluster: SpotCluster, outline: Ellipse) -> bool:
    """Return whether most spots of a cluster are inside an outline."""
    return float(np.median(np.linalg.norm(outline.unit(cluster.spots_px), axis=1))) < 0.9


def round_outlines(values: Images, radii_px: Sequence[float] = ()) -> int:
    """Count the circles with these radii in a stack, including those that are not spheres."""
    return sum(expected(circle, radii_px) for circle in round_edges(values))


def round_edges(values: Images) -> list[Ellipse]:
    """Return the circular edges of the mean image, best visible first."""
    return circular_edges(outline_image(values))


def _has_highlights(values: Images, circle: Ellipse) -> bool:
    """Return whether a circle shows a highlight under half of a few lights."""
    few = values[:: -(-len(values) // _FEW)]
    return bool(2 * np.count_nonzero(find_highlights(few, circle).found) >= len(few))


def _refined(
    pictures: OutlineImages, circle: Ellipse, rivals: Sequence[Ellipse] = ()
) -> tuple[Ellipse, Array, float] | None:
    """Refine a circle; return outline, its points and coverage, None if too little is visible.

    The refinement moves the outline by up to 3 px or 3 % of the radius. If it is not sharp, so that
    it cannot replace its rivals, it may be inexact.
    """
    reach = max(_REACH_PX, _REACH_SHARE * circle.radius_px)
    try:
        outline, points, coverage = refine_sharpest(pictures, circle, reach, rivals)
    except EstimateError:
        return None
    if coverage < LEAST_COVERAGE or abs(outline.radius_px / circle.radius_px - 1) > 0.15:
        return None
    return outline, points, coverage


def mirroring(
    values: Images, outline: Ellipse, points: Array, coverage: float
) -> SphereImage | None:
    """Return the sphere with an outline if its highlights are those of a mirror."""
    highlights = find_highlights(values, outline)
    seen = highlights.pixels[highlights.found]
    if len(seen) < 0.5 * len(values):
        return None
    if len(seen) > 1 and np.max(np.ptp(seen, axis=0)) < max(1.0, 0.02 * outline.radius_px):
        return None
    if is_painted(values, outline, highlights):
        return None
    return SphereImage(outline, points, coverage, highlights)


def expected(circle: Ellipse, radii_px: Sequence[float]) -> bool:
    """Return whether a circle has one of the radii, to 15 %.

    A mirrored horizon has 75 % of the radius or less.
    """
    return not radii_px or any(abs(circle.radius_px / radius - 1) < 0.15 for radius in radii_px)


def overlap(a: Ellipse, b: Ellipse) -> bool:
    """Return whether the centre of one outline is inside the other."""
    distance = np.hypot(a.centre_px[0] - b.centre_px[0], a.centre_px[1] - b.centre_px[1])
    return bool(distance < max(a.radius_px, b.radius_px))
