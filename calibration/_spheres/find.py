"""Search for mirror spheres without masks: circles that contain a moving highlight."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from acquisition import CameraModel
from calibration._errors import EstimateError
from calibration._radiance.raw_stack import Images
from calibration._spheres.confirmed import confirmed, in_all_images
from calibration._spheres.ellipse import Ellipse
from calibration._spheres.highlights import find_highlights
from calibration._spheres.mirror_outline import outlined_mirror
from calibration._spheres.mirrors import Mirror, find_mirror
from calibration._spheres.outline import (
    SHARP_PX,
    OutlineImages,
    outline_image,
    refine_sharpest,
    scatter_px,
)
from calibration._spheres.painted import is_painted
from calibration._spheres.robust import Array
from calibration._spheres.sphere_image import SphereImage
from calibration._spheres.spots import ReducedStack, SpotCluster, reduce_stack, spot_clusters
from calibration._spheres.surroundings import MirroredPlane

_SEARCH_SIZE_PX = 700
_SMALLEST_RADIUS_PX = 8
_EDGES = 20000
_CENTRES = 60
_CANDIDATES = 120
_SECTORS = 72
_LEAST_COVERAGE = 0.35
_HORIZON, _CONCENTRIC = 0.73, 0.15
_REACH_PX, _REACH_SHARE = 3.0, 0.03
_FEW = 8
# Radii for which votes are counted at once.
_AT_ONCE = 8


def find_spheres(
    values: Images,
    radii_px: Sequence[float] = (),
    excluded: Sequence[SphereImage] = (),
    camera: CameraModel | None = None,
    reduced: ReducedStack | None = None,
) -> list[SphereImage]:
    """Find the mirror spheres in a stack.

    Bright spots of different lights at one place show where a sphere may be. Of all balls around
    such a place, the one that mirrors the plane around it best is the sphere (`MirroredPlane`);
    then its outline is refined, and confirmed by the edges of all images: where they contradict it,
    there is no such plane, and their outline is used. If no ball mirrors a plane, because it is
    missing or black, the round edges of the mean image around that place are examined: one of them
    is the outline if more than a third of it is visible, it shows a compact highlight under at
    least half of the lights, the highlight moves with the light, by 1 px and 2 % of the radius, and
    its middle is not shaded as that of a painted ball is. Of overlapping edges (a sphere mirrors
    circles inside itself), the largest well-covered one is the outline.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, NaN where saturated.
    radii_px
        Expected radii of the spheres in the image, to 15 %. Default: any radius.
    excluded
        Spheres that are already known; candidates that overlap them are skipped.
    camera
        Camera of the images. Default: unknown.
    reduced
        The images at a lower resolution, if they are known.

    Returns
    -------
    list of SphereImage
        The spheres, sorted by x; empty if none was found.

    Examples
    --------
    >>> import numpy as np
    >>> from calibration import find_spheres
    >>> find_spheres(np.full((3, 48, 64), 0.2, np.float32))  # no sphere in even images
    []
    """
    reduced = reduced or reduce_stack(values)
    plane = MirroredPlane(values, reduced, camera)
    undecided: list[SpotCluster] = []
    mirroring: list[SphereImage] = []
    for cluster in spot_clusters(reduced):
        known = [*excluded, *mirroring]
        if any(inside(cluster, sphere.outline) for sphere in known):
            continue
        mirror = find_mirror(plane, cluster)
        if mirror is None and len(radii_px):
            mirror = find_mirror(plane, cluster, radii_px)
        if mirror is None:
            undecided.append(cluster)
        elif _expected(mirror.outline(plane.camera), radii_px):
            sphere = outlined_mirror(values, plane, mirror)
            if not _rivals(sphere.outline, known):
                mirroring.append(sphere)
    spheres = [
        one
        for one in confirmed(values, mirroring)
        if one is not None and _expected(one.outline, radii_px)
    ]
    if undecided:
        for sphere in spheres_by_edges(values, undecided, radii_px, [*excluded, *mirroring]):
            around = _ball_around(plane, sphere, undecided)
            if around is None:
                one = in_all_images(values, sphere)
            else:
                one = confirmed(values, [outlined_mirror(values, plane, around)])[0]
            if one is not None:
                spheres.append(one)
    return sorted(spheres, key=lambda sphere: sphere.outline.centre_px)


def _ball_around(
    plane: MirroredPlane, sphere: SphereImage, clusters: Sequence[SpotCluster]
) -> Mirror | None:
    """Return the ball in which an edge is the mirrored horizon, or None.

    A sphere mirrors the horizon at about 73 % of its radius. A ball of that size around the edge,
    with the same centre, that mirrors the plane fairly well is the sphere.
    """
    edge = sphere.outline
    for cluster in clusters:
        if inside(cluster, edge):
            ball = find_mirror(plane, cluster, [edge.radius_px / _HORIZON])
            if ball is not None:
                outline = ball.outline(plane.camera)
                offset = np.subtract(outline.centre_px, edge.centre_px)
                if np.hypot(*offset) < _CONCENTRIC * outline.radius_px:
                    return ball
    return None


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
    circles = [circle for circle in _circles(pictures.upper) if _expected(circle, radii_px)]
    spheres: list[SphereImage] = []
    for circle in circles[:_CANDIDATES]:
        if not any(inside(cluster, circle) for cluster in clusters):
            continue
        sharp = [sphere for sphere in spheres if sphere.rms_px < SHARP_PX]
        if _rivals(circle, [*known, *sharp]):
            continue
        rivals = _rivals(circle, spheres)
        edge = _refined(pictures, circle, [sphere.outline for sphere in rivals])
        if edge is None or not _expected(edge[0], radii_px) or _rivals(edge[0], known):
            continue
        # What is slower is checked last: most circles around a ball are mirrored in it.
        if not rivals and not _has_highlights(values, circle):
            continue
        rivals = _rivals(edge[0], spheres)
        if not all(scatter_px(*edge[:2]) < SHARP_PX < rival.rms_px for rival in rivals):
            continue
        sphere = _mirroring(values, *edge)
        if sphere is not None:
            spheres = [other for other in spheres if other not in rivals] + [sphere]
    return spheres


def _rivals(outline: Ellipse, spheres: Sequence[SphereImage]) -> list[SphereImage]:
    """Return the spheres that overlap an outline."""
    return [sphere for sphere in spheres if overlap(outline, sphere.outline)]


def inside(cluster: SpotCluster, outline: Ellipse) -> bool:
    """Return whether most spots of a cluster are inside an outline."""
    return float(np.median(np.linalg.norm(outline.unit(cluster.spots_px), axis=1))) < 0.9


def round_outlines(values: Images, radii_px: Sequence[float] = ()) -> int:
    """Count the circles with these radii in a stack, including those that are not spheres."""
    return sum(_expected(circle, radii_px) for circle in round_edges(values))


def round_edges(values: Images) -> list[Ellipse]:
    """Return the circular edges of the mean image, best visible first."""
    return _circles(outline_image(values))


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
    if coverage < _LEAST_COVERAGE or abs(outline.radius_px / circle.radius_px - 1) > 0.15:
        return None
    return outline, points, coverage


def _mirroring(
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


def _expected(circle: Ellipse, radii_px: Sequence[float]) -> bool:
    """Return whether a circle has one of the radii, to 15 %.

    A mirrored horizon has 75 % of the radius or less.
    """
    return not radii_px or any(abs(circle.radius_px / radius - 1) < 0.15 for radius in radii_px)


def overlap(a: Ellipse, b: Ellipse) -> bool:
    """Return whether the centre of one outline is inside the other."""
    distance = np.hypot(a.centre_px[0] - b.centre_px[0], a.centre_px[1] - b.centre_px[1])
    return bool(distance < max(a.radius_px, b.radius_px))


def _circles(image: npt.NDArray[np.float32]) -> list[Ellipse]:
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
        Ellipse(
            ((centre[0] + 0.5) * scale - 0.5, (centre[1] + 0.5) * scale - 0.5),
            (radius * scale, radius * scale),
        )
        for _, centre, radius in scored
    ]


def _edges(image: npt.NDArray[np.float32]) -> tuple[Array, Array]:
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


def _between(image: npt.NDArray[np.float32], x: Array, y: Array) -> Array:
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
    between: Array = upper + down * (lower - upper)
    return between


def _centres(
    edges: Array, facing: Array, shape: tuple[int, int], largest: float
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
    edges: Array, facing: Array, centre: tuple[float, float], largest: float
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
    while coverage.max() > _LEAST_COVERAGE:
        best = int(np.argmax(coverage))
        circles.append((best + 1.5, float(coverage[best])))
        coverage[best - 4 : best + 5] = 0.0
    return circles
