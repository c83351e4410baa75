"""Search for a ball that is out of focus, whose outline no single image shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration._radiance.raw_stack import Images
from calibration._spheres.confirmed import in_all_images
from calibration._spheres.edge_search import expected, inside, mirroring, round_edges
from calibration._spheres.ellipse import Ellipse
from calibration._spheres.joint_search import change_of
from calibration._spheres.sphere_image import SAFE_COVERAGE, SphereImage
from calibration._spheres.spots import SpotCluster

# The edges of all images are compared around so many circles that differ by this share of the
# radius.
_MOST, _APART = 4, 0.1


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
        rough = mirroring(values, circle, np.zeros((0, 2)), 0.0)
        sphere = None if rough is None else in_all_images(values, rough)
        if sphere is not None and sphere.coverage >= SAFE_COVERAGE:
            return sphere if expected(sphere.outline, radii_px) else None
    return None


def _near(a: Ellipse, b: Ellipse) -> bool:
    """Return whether two circles lead to the same outline."""
    return float(np.abs(change_of(a, b)).max()) < _APART * b.radius_px
