"""Search for mirror spheres without masks: balls that mirror what surrounds them, or edges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from acquisition import CameraModel
from calibration._radiance.raw_stack import Images
from calibration._spheres.confirmed import confirmed, in_all_images
from calibration._spheres.edge_search import expected, inside, rivals_of, spheres_by_edges
from calibration._spheres.mirror_outline import outlined_mirror
from calibration._spheres.mirrors import Mirror, find_mirror
from calibration._spheres.out_of_focus import sphere_out_of_focus
from calibration._spheres.sphere_image import SphereImage
from calibration._spheres.spots import ReducedStack, SpotCluster, reduce_stack, spot_clusters
from calibration._spheres.surroundings import MirroredPlane

_HORIZON, _CONCENTRIC = 0.73, 0.15


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
        elif expected(mirror.outline(plane.camera), radii_px):
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
            ball = find_mirror(plane, cluster, [edge.radius_px / _HORIZON])
            if ball is not None:
                outline = ball.outline(plane.camera)
                offset = np.subtract(outline.centre_px, edge.centre_px)
                if np.hypot(*offset) < _CONCENTRIC * outline.radius_px:
                    return ball
    return None
