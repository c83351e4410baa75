"""Places that look like a sphere to some degree, for a person to decide."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition import CameraModel
from calibration.radiance.stack import Images, Stack
from calibration.spheres.geometry.ellipse import Ellipse
from calibration.spheres.highlights.spots import reduce_stack, spot_clusters
from calibration.spheres.outline.mirror_search import LEAST_SHARE, accepted, best_mirror, outline_of
from calibration.spheres.outline.surroundings import Balls, MirroredPlane
from calibration.spheres.propose.edge_search import inside, overlap, round_edges, spheres_by_edges
from calibration.spheres.recording import gray_stack

_MOST = 8


@dataclass(frozen=True)
class SphereCandidate:
    """A circle in the images that may be the outline of a mirror sphere.

    Parameters
    ----------
    circle_px
        Centre x, centre y and radius in pixels, an approximate circle for `calibrate_spheres`.
    lights
        Number of lights that have a bright spot in it; 0 for a round edge without such spots.
    mirrored
        Share of the differences near its limb that the surroundings, mirrored in a ball, explain; a
        sphere that is found without a mask has 0.5 or more, and balls of another radius have much
        less. NaN if it was not compared.
    """

    circle_px: tuple[float, float, float]
    lights: int
    mirrored: float

    def reason(self) -> str:
        """Return why the search does not take it for a sphere, for people."""
        if not self.lights:
            return "a round edge without a highlight that moves with the light"
        share = 100 * max(self.mirrored, 0.0)
        if not self.mirrored >= LEAST_SHARE:
            return f"highlights, but it mirrors only {share:.0f} % of what surrounds it"
        return (
            f"it mirrors {share:.0f} % of what surrounds it, but it does not have the given "
            "radius, or a ball of another radius mirrors nearly as much"
        )


def sphere_candidates(
    stack: Stack | Images, *, camera: CameraModel | None = None
) -> list[SphereCandidate]:
    """Return the places that may be mirror spheres, for a person to choose from.

    Use it if `calibrate_spheres` found none: a circle that is one can be given to it.

    Parameters
    ----------
    stack, camera
        As for `calibrate_spheres`.

    Returns
    -------
    list of SphereCandidate
        At most 8: first clusters of highlights, those that mirror their surroundings best first,
        then round edges, those that are visible over most of their circumference first.

    Examples
    --------
    >>> import numpy as np
    >>> from calibration.spheres import sphere_candidates
    >>> sphere_candidates(np.full((3, 48, 64), 0.2, np.float32))  # nothing in even images
    []
    """
    values = gray_stack(stack).values
    reduced = reduce_stack(values)
    plane = MirroredPlane(values, reduced, camera)
    edges = round_edges(values)
    clusters = spot_clusters(reduced)
    # Those that show highlights as a mirror does come first: the search refused their outlines.
    likely = [one.outline for one in spheres_by_edges(values, clusters, (), ())]
    spheres: list[SphereCandidate] = []
    for cluster in clusters:
        best = best_mirror(plane, cluster)
        share = -1.0 if best is None else float(best[1].share[0])
        around = [edge for edge in [*likely, *edges] if inside(cluster, edge)]
        if best is not None and (accepted(plane, *best) or not around):
            outline = outline_of(plane.camera, best[0])
        elif around:
            outline = around[0]
            circle = Balls(np.array([outline.centre_px]), np.array([outline.radius_px]))
            share = float(plane.compare(circle).share[0])
        else:
            continue
        spheres.append(SphereCandidate(outline.circle_px, len(cluster.spots_px), share))
    spheres.sort(key=lambda one: -one.mirrored)
    for edge in edges:
        if not any(overlap(edge, Ellipse.circle(*one.circle_px)) for one in spheres):
            spheres.append(SphereCandidate(edge.circle_px, 0, float("nan")))
    return spheres[:_MOST]
