"""The outline of a ball that mirrors its surroundings, from the mirror image and from the edge."""

from __future__ import annotations

import numpy as np

from calibration._errors import EstimateError
from calibration._radiance.raw_stack import Images
from calibration._spheres.ellipse import Ellipse
from calibration._spheres.highlights import find_highlights
from calibration._spheres.mirror_fit import FittedBall, fit_mirror
from calibration._spheres.mirrors import Mirror, outline_of
from calibration._spheres.outline import outline_image, refine_edges
from calibration._spheres.outline_noise import OUTLINE_SIGMA_PX, circle_covariance
from calibration._spheres.robust import Array
from calibration._spheres.sphere_image import SphereImage
from calibration._spheres.surroundings import Balls, MirroredPlane, outlines_of

# A search finds a ball to about 1 % of its radius.
_SEARCH_SHARE = 0.01
_AROUND_PX = 8
_FINEST_PX = 0.01
# An edge that is visible over less of the circumference may be another one, and its place and
# radius depend on each other.
_LEAST_EDGE = 0.75
# On simulated boards, the radius of edges is off by this.
_EDGE_RADIUS_SIGMA_PX = 0.04
# The 99.9 % quantile of chi-square with 3 degrees of freedom.
_SAME_OUTLINE = 16.3


def outlined_mirror(values: Images, plane: MirroredPlane, mirror: Mirror) -> SphereImage:
    """Return the sphere of a ball that mirrors the plane, with its outline and covariance.

    The mirror image near the limb determines the outline on any ground. The edge determines it
    better on a plain ground, and worse or wrongly where print or shadows meet it. Their mean with
    the inverse covariances as weights is the outline; an edge that contradicts the mirror image is
    not that of the ball.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, NaN where saturated.
    plane
        The images.
    mirror
        The ball, to about 1 % of its radius.
    """
    fitted = fit_mirror(plane, mirror)
    if fitted is None:
        size = mirror.outline(plane.camera).radius_px
        fitted = FittedBall(mirror.ball, np.eye(3) * (_SEARCH_SHARE * size) ** 2)
    ball, covariance = fitted.ball, fitted.covariance_px2
    edge = _edge(values, outline_of(plane.camera, ball))
    if edge is not None:
        change, of_edge = edge
        both = covariance + of_edge
        if change @ np.linalg.solve(both, change) < _SAME_OUTLINE:
            gain = covariance @ np.linalg.inv(both)
            ball, covariance = _changed(ball, gain @ change), covariance - gain @ covariance
    outline = outline_of(plane.camera, ball)
    count = int(np.clip(2 * np.pi * outline.radius_px, 90, 720))
    points = outlines_of(plane.camera, ball, count)[0]
    height, width = values.shape[1:]
    visible = np.all((points > 0) & (points < (width - 1, height - 1)), axis=1)
    return SphereImage(
        outline,
        points[visible],
        float(visible.mean()),
        find_highlights(values, outline),
        covariance_px2=_without_systematic(covariance),
    )


def _without_systematic(covariance: Array) -> Array:
    """Return what remains of a covariance without the systematic error of all outlines."""
    values, vectors = np.linalg.eigh(covariance)
    rest = np.maximum(values - OUTLINE_SIGMA_PX**2, _FINEST_PX**2)
    remaining: Array = (vectors * rest) @ vectors.T
    return remaining


def _edge(values: Images, guess: Ellipse) -> tuple[Array, Array] | None:
    """Return by how much an edge differs from a guess in (x, y, radius), and its covariance."""
    centre, reach = np.array(guess.centre_px), max(guess.semi_axes_px) + _AROUND_PX
    low = np.maximum((centre - reach).astype(int), 0)
    high = np.minimum((centre + reach).astype(int) + 2, values.shape[:0:-1])
    if np.any(high - low < 2 * _AROUND_PX):
        return None
    image = outline_image(values[:, low[1] : high[1], low[0] : high[0]])
    moved = Ellipse((centre[0] - low[0], centre[1] - low[1]), guess.semi_axes_px, guess.angle_deg)
    try:
        edge, points, coverage = refine_edges(image, moved, curved=True)
    except EstimateError:
        return None
    if coverage < _LEAST_EDGE:
        return None
    (x, y), (x0, y0) = edge.centre_px, moved.centre_px
    change = np.array([x - x0, y - y0, edge.radius_px - moved.radius_px])
    return change, circle_covariance(points, edge) + np.diag([0, 0, _EDGE_RADIUS_SIGMA_PX**2])


def _changed(ball: Balls, change: Array) -> Balls:
    return Balls(ball.axes_px + change[:2], ball.radii_px + change[2], ball.slopes)
