"""Selection of the spheres among round outlines, by sharpness and size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from acquisition import CameraModel
from calibration._errors import EstimateError
from calibration.radiance.stack import Images
from calibration.spheres.geometry.ellipse import Ellipse
from calibration.spheres.highlights.spots import (
    ReducedStack,
    SpotCluster,
    reduce_stack,
    spot_clusters,
)
from calibration.spheres.outline.mirror_outline import outlined_mirror
from calibration.spheres.outline.mirror_search import Mirror, find_mirror, outline_of
from calibration.spheres.outline.outline import SHARP_PX, TracedOutline
from calibration.spheres.outline.outline_confirmation import HORIZON, confirmed, in_all_images
from calibration.spheres.outline.sphere_image import SAFE_COVERAGE, SphereImage, circles_of, places
from calibration.spheres.outline.surroundings import MirroredPlane
from calibration.spheres.propose.edge_search import (
    expected,
    inside,
    mirroring,
    overlap,
    rivals_of,
    round_edges,
    round_outlines,
    spheres_by_edges,
)
from calibration.spheres.solve.sphere_positions import radius_on_plane_mm
from rig import Notice, pluralize
from rig.arrays import Float64, Intp

_SHARP_OUTLINE_RATIO = 3.0
# Highlights this close to the border, relative to the shorter side, may be those of a cut sphere;
# those of one sphere are not farther apart, and half of them are closer to the border: the others
# are beyond it.
_MARGIN, _CLOSE = 0.1, 0.05
# One light may glint anywhere.
_LEAST_LIGHTS = 3
_LEAST_SHARE = 0.2
# The mirror image of an LED lies within the outline; glare around it may reach beyond.
_INSIDE = 1.1
_CONCENTRIC = 0.15
# The edges of all images are compared around so many circles that differ by this share of the
# radius.
_MOST, _APART = 4, 0.1


def searched_spheres(
    values: Images, camera: CameraModel | None, radii_mm: Float64 | None
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
    notices = [
        Notice(
            "sphere-blurred",
            f"{places([image])} was left out: the outline scatters by {image.rms_px:.1f} px, too "
            "much for a mirror sphere",
        )
        for image in blurred
    ]
    return notices + cut_spheres(reduced, [*found, *blurred])


def cut_spheres(stack: ReducedStack, found: list[SphereImage]) -> list[Notice]:
    """Return a notice for each group of highlights at the border without a sphere.

    The frame cuts a sphere off, and what is visible of it does not determine its outline.

    Parameters
    ----------
    stack
        The images at a lower resolution.
    found
        The spheres that were found, whose highlights do not count.
    """
    spots = stack.spots
    rows, columns = stack.peak.shape[1:]
    margin = _MARGIN * min(rows, columns)
    x, y = spots[:, 1], spots[:, 2]
    to_border = np.minimum(np.minimum(x, columns - 1 - x), np.minimum(y, rows - 1 - y))
    alone = to_border <= margin
    places = stack.full_px(spots[:, 1:3])
    for sphere in found:
        outline = sphere.outline
        reach = _INSIDE * outline.radius_px
        alone &= np.linalg.norm(places - outline.centre_px, axis=1) > reach
    lights, places, to_border = spots[alone, 0].astype(int), places[alone], to_border[alone]
    least = max(_LEAST_LIGHTS, _LEAST_SHARE * len(stack.peak))
    notices = []
    for group in _groups(places, margin * stack.factor):
        count = len(np.unique(lights[group]))
        if count >= least and np.median(to_border[group]) <= _CLOSE * min(rows, columns):
            notices.append(_notice(count, np.median(places[group], axis=0)))
    return notices


def _groups(places: Float64, reach: float) -> list[Intp]:
    """Return the indices of places that are less than ``reach`` from the next one."""
    left = list(range(len(places)))
    groups = []
    while left:
        group = [left.pop()]
        for member in group:
            apart = np.linalg.norm(places[left] - places[member], axis=1)
            near = [index for index, distance in zip(left, apart, strict=True) if distance < reach]
            group += near
            left = [index for index in left if index not in near]
        groups.append(np.array(sorted(group)))
    return groups


def _notice(lights: int, centre_px: Float64) -> Notice:
    x, y = centre_px
    text = (
        f"a sphere at ({x:.0f}, {y:.0f}) px is not used: "
        f"{pluralize(lights, 'light')} shine in it, but too little of it is in the image for its "
        "outline; move it into the field, or ignore this"
    )
    return Notice("sphere-cut", text)


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
    circles inside itself), the largest well-covered one is the outline. Without such an
    edge, those of all images are compared around the best visible circles: the ball may be out of
    focus.

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
        elif expected(outline_of(plane.camera, mirror.ball), radii_px):
            sphere = outlined_mirror(values, plane, mirror)
            if not rivals_of(sphere.outline, known):
                mirroring.append(sphere)
    spheres = [
        one
        for one in confirmed(values, mirroring)
        if one is not None and expected(one.outline, radii_px)
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
    if undecided and not spheres and not excluded:
        blurred = sphere_out_of_focus(values, undecided, radii_px)
        spheres = [] if blurred is None else [blurred]
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
            ball = find_mirror(plane, cluster, [edge.radius_px / HORIZON])
            if ball is not None:
                outline = outline_of(plane.camera, ball.ball)
                if edge.apart_px(outline) < _CONCENTRIC * outline.radius_px:
                    return ball
    return None


def sphere_out_of_focus(
    values: Images, clusters: Sequence[SpotCluster], radii_px: Sequence[float]
) -> SphereImage | None:
    """Return the sphere near the best visible circles, or None.

    Blurred edges show a circle of about the right size, but no sharp outline. The edges of all
    images decide, also in smaller images. They have to confirm so much of an outline that no other
    one nearby fits as well.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, NaN where saturated.
    clusters
        Spots that move with the light.
    radii_px
        Expected radii; any if empty.
    """
    tried: list[Ellipse] = []
    for circle in round_edges(values):
        if len(tried) == _MOST:
            break
        around = any(inside(cluster, circle) for cluster in clusters)
        if not (around and expected(circle, radii_px)) or any(_near(circle, one) for one in tried):
            continue
        tried.append(circle)
        rough = mirroring(values, TracedOutline(circle, np.zeros((0, 2)), 0.0))
        sphere = None if rough is None else in_all_images(values, rough)
        if sphere is not None and sphere.coverage >= SAFE_COVERAGE:
            return sphere if expected(sphere.outline, radii_px) else None
    return None


def _near(a: Ellipse, b: Ellipse) -> bool:
    """Return whether two circles lead to the same outline."""
    return float(np.abs(a.change_to(b)).max()) < _APART * b.radius_px
