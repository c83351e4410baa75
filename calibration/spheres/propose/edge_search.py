"""Search for mirror spheres by round edges that contain a moving highlight."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from calibration._errors import or_none
from calibration.radiance.stack import Images
from calibration.spheres.geometry.ellipse import Ellipse
from calibration.spheres.geometry.reflection import orthographic_directions
from calibration.spheres.highlights.highlights import Highlights, find_highlights
from calibration.spheres.highlights.spots import SpotCluster
from calibration.spheres.outline.outline import (
    SHARP_PX,
    OutlineImages,
    TracedOutline,
    outline_image,
    refine_sharpest,
    usual_reach_px,
)
from calibration.spheres.outline.sphere_image import SphereImage
from rig.arrays import Float32, Float64

_CANDIDATES = 120
_FEW = 8
# The middle of a ball, without its highlights, in multiples of the radius.
_MIDDLE = 0.7
_APART = 0.3
_STEPS = 15
_SHADED = 0.6
_SEARCH_SIZE_PX = 700
_SMALLEST_RADIUS_PX = 8
_EDGES = 20000
_CENTRES = 60
_SECTORS = 72
# Less of a circle may be chance.
LEAST_COVERAGE = 0.35
# Radii for which votes are counted at once.
_AT_ONCE = 8


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
        if edge is None or not expected(edge.outline, radii_px) or rivals_of(edge.outline, known):
            continue
        # What is slower is checked last: most circles around a ball are mirrored in it.
        if not rivals and not _has_highlights(values, circle):
            continue
        rivals = rivals_of(edge.outline, spheres)
        if not all(edge.rms_px < SHARP_PX < rival.rms_px for rival in rivals):
            continue
        sphere = mirroring(values, edge)
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
) -> TracedOutline | None:
    """Refine a circle; return None if too little of its outline is visible.

    The refinement moves the outline by up to 3 px or 3 % of the radius. If it is not sharp, so that
    it cannot replace its rivals, it may be inexact.
    """
    reach_px = usual_reach_px(circle.radius_px)
    found = or_none(refine_sharpest, pictures, circle, reach_px, rivals)
    if found is None or found.coverage < LEAST_COVERAGE:
        return None
    return None if abs(found.outline.radius_px / circle.radius_px - 1) > 0.15 else found


def mirroring(values: Images, edge: TracedOutline) -> SphereImage | None:
    """Return the sphere with an outline if its highlights are those of a mirror."""
    outline = edge.outline
    highlights = find_highlights(values, outline)
    seen = highlights.pixels[highlights.found]
    if len(seen) < 0.5 * len(values):
        return None
    if len(seen) > 1 and np.max(np.ptp(seen, axis=0)) < max(1.0, 0.02 * outline.radius_px):
        return None
    if is_painted(values, outline, highlights):
        return None
    return SphereImage(outline, edge.points_px, edge.coverage, highlights)


def expected(circle: Ellipse, radii_px: Sequence[float]) -> bool:
    """Return whether a circle has one of the radii, to 15 %.

    A mirrored horizon has 75 % of the radius or less.
    """
    return not radii_px or any(abs(circle.radius_px / radius - 1) < 0.15 for radius in radii_px)


def overlap(a: Ellipse, b: Ellipse) -> bool:
    """Return whether the centre of one outline is inside the other."""
    return a.apart_px(b) < max(a.radius_px, b.radius_px)


def is_painted(values: Images, outline: Ellipse, highlights: Highlights) -> bool:
    """Return whether the middle of a ball is shaded like a matte surface.

    The middle of a mirror shows the camera and the ceiling, whose brightness does not follow the
    cosine of the angle between the ball's normal and the light. That of a painted ball does, with
    or without gloss: the correlation over lights and places exceeds 0.6.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, NaN where saturated.
    outline
        The outline of the ball.
    highlights
        Its highlights.
    """
    grid = np.linspace(-_MIDDLE, _MIDDLE, _STEPS)
    x, y = (v.ravel() for v in np.meshgrid(grid, grid))
    inside = np.hypot(x, y) < _MIDDLE
    unit = np.column_stack([x, y])[inside]
    pixels = np.rint(unit @ outline.matrix + outline.centre_px).astype(int)
    height, width = values.shape[1:]
    seen = np.all((pixels >= 0) & (pixels < (width, height)), axis=1)
    unit, pixels = unit[seen], pixels[seen]
    lit = np.flatnonzero(highlights.found)
    if len(lit) < 3 or len(unit) < 20:
        return False
    normals = np.column_stack([unit[:, 0], -unit[:, 1], np.sqrt(1 - np.sum(unit**2, axis=1))])
    directions = orthographic_directions(outline, highlights.pixels[lit])
    shading: Float64 = np.clip(normals @ directions.T, 0, None).T
    brightness = values[lit][:, pixels[:, 1], pixels[:, 0]].astype(np.float64)
    spots = outline.unit(highlights.pixels[lit])
    apart = np.linalg.norm(spots[:, None] - unit, axis=2) > _APART
    use = apart & np.isfinite(brightness)
    if np.count_nonzero(use) < 50 or np.ptp(brightness[use]) <= 0:
        return False
    correlation = float(np.corrcoef(brightness[use], shading[use])[0, 1])
    return correlation > _SHADED


def circular_edges(image: Float32) -> list[Ellipse]:
    """Return the circular edges of an image, sorted by coverage, then by size, descending."""
    factor = max(1.0, max(image.shape) / _SEARCH_SIZE_PX)
    size = (max(round(image.shape[1] / factor), 1), max(round(image.shape[0] / factor), 1))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    edges, facing = _edges(np.log(small))
    largest = 0.6 * min(small.shape)
    centres = _centres(edges, facing, (small.shape[0], small.shape[1]), largest)
    scored = [
        (coverage, centre, radius)
        for centre in centres
        for radius, coverage in _radii(edges, facing, centre, largest)
    ]
    # If the coverage is similar, the larger circle is the outline and not a mirrored circle.
    scored.sort(key=lambda item: (round(item[0] / 0.25), item[2]), reverse=True)
    scale = image.shape[1] / size[0]
    return [
        Ellipse.circle((x + 0.5) * scale - 0.5, (y + 0.5) * scale - 0.5, radius * scale)
        for _, (x, y), radius in scored
    ]


def _edges(image: Float32) -> tuple[Float64, Float64]:
    """Return edge pixels ``(M, 2)``, maxima along the gradient, and unit gradients ``(M, 2)``."""
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0)
    gx = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8)
    gy = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8)
    strength = np.hypot(gx, gy)
    y, x = np.nonzero(strength > max(3 * float(np.median(strength)), 1e-3))
    facing = np.column_stack([gx[y, x], gy[y, x]]) / strength[y, x, None]
    ahead, behind = (
        _between(strength, x + sign * facing[:, 0], y + sign * facing[:, 1]) for sign in (1, -1)
    )
    ridge = (strength[y, x] >= ahead) & (strength[y, x] > behind)
    # Keep the strongest edges: enough for every circle, few enough for a fast vote.
    keep = np.flatnonzero(ridge)
    keep = keep[np.argsort(strength[y[keep], x[keep]])[-_EDGES:]]
    return np.column_stack([x, y])[keep].astype(np.float64), facing[keep].astype(np.float64)


def _between(image: Float32, x: Float64, y: Float64) -> Float64:
    """Return an image between its pixels, linearly; `cv2.remap` rounds places to 1/32 px."""
    height, width = image.shape
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    left, top = (np.minimum(at.astype(np.intp), size - 2) for at, size in ((x, width), (y, height)))
    first = top * width + left
    pixels = image.ravel()
    across, down = x - left, y - top
    upper, lower = (
        pixels[row] + across * (pixels[row + 1] - pixels[row]) for row in (first, first + width)
    )
    return np.asarray(upper + down * (lower - upper))


def _centres(
    edges: Float64, facing: Float64, shape: tuple[int, int], largest: float
) -> list[tuple[float, float]]:
    """Vote along the gradients in both directions, and return the peaks."""
    height, width = shape
    votes = np.zeros(height * width, np.intp)
    at, step = (np.ascontiguousarray(of.T, np.float32) for of in (edges, facing))
    radii = np.arange(_SMALLEST_RADIUS_PX, largest, dtype=np.float32)
    for first in range(0, len(radii), _AT_ONCE):
        some = radii[first : first + _AT_ONCE]
        moves = np.concatenate([some, -some])[:, None, None] * step
        column, row = np.moveaxis(np.rint(np.add(moves, at, out=moves), out=moves), 1, 0)
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        place = (row[inside] * width + column[inside]).astype(np.intp)
        votes += np.bincount(place, minlength=len(votes))
    # The error of a vote is proportional to the radius: smooth the votes over a few pixels, and
    # subtract the broad background from clutter.
    plane = cv2.GaussianBlur(votes.reshape(shape).astype(np.float64), (0, 0), 1.5)
    plane = plane - cv2.GaussianBlur(plane, (0, 0), 12.0)
    peaks = []
    for _ in range(_CENTRES):
        _, best, _, (x, y) = cv2.minMaxLoc(plane)
        if best <= 0:
            break
        peaks.append((float(x), float(y)))
        cv2.circle(plane, (x, y), 4, 0.0, -1)
    return peaks


def _radii(
    edges: Float64, facing: Float64, centre: tuple[float, float], largest: float
) -> list[tuple[float, float]]:
    """Return (radius, coverage) of the circles around a centre.

    The coverage is the share of sectors with an edge that faces the centre.
    """
    offset = edges - centre
    radius = np.linalg.norm(offset, axis=1)
    faces = np.abs(np.sum(offset * facing, axis=1)) > 0.95 * radius
    use = faces & (radius > _SMALLEST_RADIUS_PX) & (radius < largest)
    sector = np.arctan2(offset[use, 1], offset[use, 0]) / (2 * np.pi) * _SECTORS
    hit = np.zeros((int(largest) + 3, _SECTORS), bool)
    hit[radius[use].astype(int), np.floor(sector).astype(int) % _SECTORS] = True
    thick = hit[:-2] | hit[1:-1] | hit[2:]
    coverage = thick.mean(axis=1)
    circles = []
    while coverage.max() > LEAST_COVERAGE:
        best = int(np.argmax(coverage))
        circles.append((best + 1.5, float(coverage[best])))
        coverage[best - 4 : best + 5] = 0.0
    return circles
