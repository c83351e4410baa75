"""The outline of a ball that mirrors its surroundings, from the mirror image and from the edge."""

from __future__ import annotations

import numpy as np

from calibration._radiance.raw_stack import Images
from calibration._spheres.cone import OUTLINE_SIGMA_PX
from calibration._spheres.highlights import find_highlights
from calibration._spheres.limb_fit import LimbFit, fit_limb
from calibration._spheres.mirror_fit import FittedBall, fit_mirror
from calibration._spheres.mirrors import Mirror, outline_of
from calibration._spheres.robust import Array
from calibration._spheres.sphere_image import SphereImage
from calibration._spheres.surroundings import Balls, MirroredPlane, outlines_of

# A search finds a ball to about 1 % of its radius.
_SEARCH_SHARE = 0.01
_FINEST_PX = 0.003
# The 95 % and 99.9 % quantiles of chi-square with 3 degrees of freedom.
_DOUBTED, _SAME_OUTLINE = 7.8, 16.3
# Where the two differ by more than is usual, the mirror image is wrong by this: of 213 simulated
# balls, 15 had mirror images that were .05 to .17 px off, and edges that were at most .04 px off.
_TAIL_PX = 0.1
# Errors of edges that neither scatter nor misfit show, of place and radius, times the square of the
# radius; measured on simulated boards.
_EDGE_PX3 = 5.0
# The mirror image is compared with at most this blur; what more does to its outline, in the blur.
_MOST_BLUR_PX, _OUT_OF_FOCUS = 1.8, 0.3
# On 11 patterned boards, spheres of 18 to 103 px have slopes of up to .012, a contrast of 13 or
# more and shares of .66 or more; none of six false planes around lone balls has all three.
_SURE_SLOPE, _SURE_CONTRAST, _SURE_SHARE = 0.015, 10.0, 0.65
# Errors of edges of more than the usual blur, as a share of the excess.
_USUAL_BLUR_PX, _OF_BLUR = 1.2, 0.03


def outlined_mirror(values: Images, plane: MirroredPlane, mirror: Mirror) -> SphereImage:
    """Return the sphere of a ball that mirrors the plane, with its outline and covariance.

    The mirror image near the limb determines the outline on any ground. The edge determines it
    several times better on an even ground, and hardly on print. Their mean with the inverse
    covariances as weights is the outline. If they differ by more than is usual, the mirror image
    counts less. An edge that still contradicts it is not that of the ball.

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
    edge = fit_limb(values, plane, ball)
    if edge is not None:
        ball, covariance = _combined(fitted, edge)
    outline = outline_of(plane.camera, ball)
    count = int(np.clip(2 * np.pi * outline.radius_px, 90, 720))
    points = outlines_of(plane.camera, ball, count)[0]
    height, width = values.shape[1:]
    visible = np.all((points > 0) & (points < (width - 1, height - 1)), axis=1)
    own, systematic = _parted(covariance)
    return SphereImage(
        outline,
        points[visible],
        float(visible.mean()),
        find_highlights(values, outline),
        covariance_px2=own,
        systematic_px=systematic,
        on_plane=_faces_the_camera(plane, fitted.ball),
    )


def _faces_the_camera(plane: MirroredPlane, ball: Balls) -> bool:
    """Return whether what a ball mirrors is, without doubt, a plane that faces the camera.

    The slopes of the plane are free in the fit. If there is another surface, they are not zero,
    except by chance, or if there is little to compare.
    """
    likeness = plane.compare(ball)
    slope = np.inf if ball.slopes is None else float(np.hypot(*ball.slopes[0]))
    enough = likeness.share[0] >= _SURE_SHARE and likeness.contrast[0] >= _SURE_CONTRAST
    return bool(enough and slope <= _SURE_SLOPE)


def _combined(fitted: FittedBall, edge: LimbFit) -> tuple[Balls, Array]:
    """Return the mean of a ball and its edge, with the covariance of its outline."""
    ball, covariance = fitted.ball, fitted.covariance_px2
    if edge.blur_px > _MOST_BLUR_PX:
        covariance = covariance + np.eye(3) * (_OUT_OF_FOCUS * edge.blur_px) ** 2
    moved = edge.ball.axes_px[0] - ball.axes_px[0]
    change = np.append(moved, edge.ball.radii_px - ball.radii_px)
    by_blur = _OF_BLUR * max(edge.blur_px - _USUAL_BLUR_PX, 0.0)
    unseen = np.eye(3) * ((_EDGE_PX3 / float(ball.radii_px[0]) ** 2) ** 2 + by_blur**2)
    of_edge = edge.covariance_px2 + unseen
    if _chi_square(change, covariance + of_edge) > _DOUBTED:
        known, covariance = covariance, covariance + np.eye(3) * _TAIL_PX**2
        if _chi_square(change, covariance + of_edge) > _SAME_OUTLINE:
            return ball, known
    gain = covariance @ np.linalg.inv(covariance + of_edge)
    mean = Balls(ball.axes_px + gain[:2] @ change, ball.radii_px + gain[2] @ change, ball.slopes)
    return mean, covariance - gain @ covariance


def _chi_square(change: Array, covariance: Array) -> float:
    return float(change @ np.linalg.solve(covariance, change))


def _parted(covariance: Array) -> tuple[Array, float]:
    """Return a covariance without its systematic part, and the standard deviation of this part.

    It is that of all outlines, or less if the outline is known better.
    """
    values, vectors = np.linalg.eigh(covariance)
    systematic = min(OUTLINE_SIGMA_PX, float(np.sqrt(max(values[0], _FINEST_PX**2))))
    rest = np.maximum(values - systematic**2, _FINEST_PX**2)
    own: Array = (vectors * rest) @ vectors.T
    return own, systematic
