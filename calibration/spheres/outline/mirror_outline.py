"""The outline of a ball that mirrors its surroundings, from the mirror image and from the edge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.radiance.stack import Images
from calibration.spheres.geometry.cone import OUTLINE_SIGMA_PX
from calibration.spheres.highlights.highlights import find_highlights
from calibration.spheres.outline.limb_fit import LimbFit, fit_limb
from calibration.spheres.outline.mirror_search import Mirror, outline_of
from calibration.spheres.outline.outline_noise import CHANCE, SAME_OUTLINE, chi_square
from calibration.spheres.outline.sphere_image import SphereImage
from calibration.spheres.outline.surroundings import Balls, MirroredPlane, outlines_of
from rig.arrays import Float64

# A search finds a ball to about 1 % of its radius.
_SEARCH_SHARE = 0.01
_FINEST_PX = 0.003
# Where the two differ by more than is usual, the mirror image is wrong by this: of 213 simulated
# balls, 15 had mirror images that were 0.05 to 0.17 px off, and edges that were at most 0.04 px
# off.
_TAIL_PX = 0.1
# Errors of edges that neither scatter nor misfit show, of place and radius, times the square of the
# radius; measured on simulated boards.
_EDGE_PX3 = 5.0
# The mirror image is compared with at most this blur; what more does to its outline, in the blur.
_MOST_BLUR_PX, _OUT_OF_FOCUS = 1.8, 0.3
# On 11 patterned boards, spheres of 18 to 103 px have slopes of up to 0.012, a contrast of 13 or
# more and shares of 0.66 or more; none of six false planes around lone balls has all three.
_SURE_SLOPE, _SURE_CONTRAST, _SURE_SHARE = 0.015, 10.0, 0.65
# Errors of edges of more than the usual blur, as a share of the excess.
_USUAL_BLUR_PX, _OF_BLUR = 1.2, 0.03
# The fit uses the limb from a fifth of the radius inside to two pixels inside the outline, where
# blur does not mix it with the plane.
_INNERMOST = 0.8
_MARGIN_PX = 2.0
_FINE_SPOKES = 72
_SPOKES_TOGETHER = 3
# Errors of the model that all spokes share, of place and radius; measured on simulated boards. They
# grow for smaller spheres, of which fewer pixels are compared.
_SHARED_SIGMA_PX, _SMALL_PX = 0.03, 25.0
# The tails of the blur mix the plane into the limb, which makes radii too small by this, up to the
# radius in px; those of larger spheres are not. Two pixels farther inside the tails end, but there
# the errors are twice as large.
_TAILS_PX, _TAILS_UP_TO_PX = 0.02, 60.0
_FIT_ROUNDS = 12
_CLOSE_PX, _CONVERGED_PX = 0.03, 0.004
_FEWEST_DIFFERENCES = 100
_FEWEST_GROUPS = 8
_SLOPE, _SLOPE_WITHOUT_CAMERA = 0.02, 0.1
# A pixel averages over a Gaussian: itself, the lens and the interpolation.
_START_BLUR_PX = 0.9
_BLURS_PX = (0.5, 0.65, 0.9, 1.2, 1.6)
_SPREAD = 0.8 * np.arange(-2.0, 3.0)
_SPREAD_SHARES = np.exp(-0.5 * _SPREAD**2)
_SPREAD_SHARES /= _SPREAD_SHARES.sum()


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
        size = outline_of(plane.camera, mirror.ball).radius_px
        fitted = mirror.ball, np.eye(3) * (_SEARCH_SHARE * size) ** 2
    ball, covariance = fitted
    edge = fit_limb(values, plane, ball)
    if edge is not None:
        ball, covariance = _combined(*fitted, edge)
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
        scatter_px=edge.scatter_px if edge is not None and ball is not fitted[0] else float("nan"),
        on_plane=_faces_the_camera(plane, fitted[0]),
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


def _combined(ball: Balls, covariance: Float64, edge: LimbFit) -> tuple[Balls, Float64]:
    """Return the mean of a ball and its edge, with the covariance of its outline."""
    if edge.blur_px > _MOST_BLUR_PX:
        covariance = covariance + np.eye(3) * (_OUT_OF_FOCUS * edge.blur_px) ** 2
    moved = edge.ball.axes_px[0] - ball.axes_px[0]
    change = np.append(moved, edge.ball.radii_px - ball.radii_px)
    by_blur = _OF_BLUR * max(edge.blur_px - _USUAL_BLUR_PX, 0.0)
    unseen = np.eye(3) * ((_EDGE_PX3 / float(ball.radii_px[0]) ** 2) ** 2 + by_blur**2)
    of_edge = edge.covariance_px2 + unseen
    if chi_square(change, covariance + of_edge) > CHANCE:
        known, covariance = covariance, covariance + np.eye(3) * _TAIL_PX**2
        if chi_square(change, covariance + of_edge) > SAME_OUTLINE:
            return ball, known
    gain = covariance @ np.linalg.inv(covariance + of_edge)
    mean = Balls(ball.axes_px + gain[:2] @ change, ball.radii_px + gain[2] @ change, ball.slopes)
    return mean, covariance - gain @ covariance


def _parted(covariance: Float64) -> tuple[Float64, float]:
    """Return a covariance without its systematic part, and the standard deviation of this part.

    It is that of all outlines, or less if the outline is known better.
    """
    values, vectors = np.linalg.eigh(covariance)
    systematic = min(OUTLINE_SIGMA_PX, float(np.sqrt(max(values[0], _FINEST_PX**2))))
    rest = np.maximum(values - systematic**2, _FINEST_PX**2)
    own: Float64 = (vectors * rest) @ vectors.T
    return own, systematic


def fit_mirror(plane: MirroredPlane, mirror: Mirror) -> tuple[Balls, Float64] | None:
    """Fit place and radius of a ball to what it mirrors, by robust least squares.

    Unknowns are also the slopes of the plane, which make up for a board that is not at a right
    angle to the camera's axis, or for an unknown camera. The blur is the one with the smallest
    differences. The covariance contains errors of the model: neighbouring spokes of the ball share
    them, so groups of spokes, not samples, count as independent.

    Returns
    -------
    ball, covariance_px2
        The ball, and the ``(3, 3)`` covariance of centre x, centre y and radius of its outline.
        None if the fit moves the ball by more than a twentieth of its radius, or makes it worse.
    """
    size = float(mirror.ball.radii_px[0])
    start = np.concatenate([mirror.ball.axes_px[0], mirror.ball.radii_px, [0.0, 0.0]])
    trial = _MirrorFit(plane, start, _START_BLUR_PX)
    for _ in range(_FIT_ROUNDS):
        move = trial.move()
        if move is None:
            break
        trial = _MirrorFit(plane, trial.unknowns + move, trial.blur_px)
        if np.abs(move[:3]).max() < _CLOSE_PX:
            break
    blurs = [_MirrorFit(plane, trial.unknowns, blur) for blur in _BLURS_PX]
    trial = min(blurs, key=lambda fit: fit.scale)
    for _ in range(_FIT_ROUNDS):
        move = trial.move()
        if move is None:
            return None
        trial = _MirrorFit(plane, trial.unknowns + move, trial.blur_px)
        if np.abs(move[:3]).max() < _CONVERGED_PX:
            break
    covariance = trial.covariance()
    moved = np.abs(trial.unknowns - start)[:3].max()
    if covariance is None or not moved < 0.05 * size:
        return None
    ball = trial.balls(trial.unknowns[None])
    if not plane.compare(ball).share[0] > mirror.share - 0.1:
        return None
    tails = _TAILS_PX * min(1.0, _TAILS_UP_TO_PX / size) ** 2
    return replace(ball, radii_px=ball.radii_px + tails), covariance


class _MirrorFit:
    """Differences between a ball's limb and what it should mirror, and their derivatives."""

    def __init__(self, plane: MirroredPlane, unknowns: Float64, blur_px: float) -> None:
        self.unknowns, self.blur_px = unknowns, blur_px
        size = float(unknowns[2])
        self._camera_known = plane.camera_known
        slope = _SLOPE if plane.camera_known else _SLOPE_WITHOUT_CAMERA
        self._prior = np.diag([0.0, 0.0, 0.0, slope**-2, slope**-2])
        # In smaller steps, noise would dominate the differences. The steps are symmetric: otherwise
        # the noise of the first ball would be in both its differences and their slopes.
        steps = np.array([*[0.3 * max(size / 40, 1.0) ** 0.5] * 3, 0.01, 0.01])
        margin = max(_MARGIN_PX, 2.5 * blur_px)
        depths = np.linspace(_INNERMOST, max(1 - margin / size, _INNERMOST + 0.03), 8)
        offsets = np.vstack([np.zeros(5), np.diag(steps), -np.diag(steps)])
        trials = self.balls(unknowns + offsets)
        differences, use = plane.differences(
            trials, depths, _FINE_SPOKES, _SPREAD * blur_px, _SPREAD_SHARES
        )
        seen = use.all(axis=0)
        differences = differences[..., seen]
        self._first = differences[:, 0]
        slopes = (differences[:, 1:6] - differences[:, 6:]) / (2 * steps[:, None])
        self._slopes = np.moveaxis(slopes, 1, -1)
        self._spokes = np.tile(np.arange(_FINE_SPOKES), len(depths))[seen] // _SPOKES_TOGETHER
        self.scale = 0.3
        if self._first.size:
            self.scale = max(1.4826 * float(np.median(np.abs(self._first))), 0.3)

    @staticmethod
    def balls(unknowns: Float64) -> Balls:
        """Return the balls of unknowns ``(H, 5)``."""
        return Balls(unknowns[:, :2], unknowns[:, 2], unknowns[:, 3:])

    def _normal(self) -> tuple[Float64, Float64]:
        """Return the normal matrix ``(5, 5)`` and the gradient ``(points, 5)`` of each point."""
        weight = 1 / (self.scale * (1 + (self._first / (2 * self.scale)) ** 2)) ** 2
        weighted = self._slopes * weight[..., None]
        normal: Float64 = np.einsum("cpi,cpj->ij", weighted, self._slopes) + self._prior
        return normal, np.einsum("cpi,cp->pi", weighted, self._first)

    def move(self) -> Float64 | None:
        """Return the next step of the unknowns; None if too little of the limb can be compared."""
        if self._first.size < _FEWEST_DIFFERENCES:
            return None
        normal, gradients = self._normal()
        step = -np.linalg.solve(normal, gradients.sum(axis=0) + self._prior @ self.unknowns)
        limit = np.array([*[0.02 * self.unknowns[2]] * 3, 0.05, 0.05])
        return np.clip(step, -limit, limit)

    def covariance(self) -> Float64 | None:
        """Return the covariance ``(3, 3)`` of place and radius, None if it is undetermined.

        If the camera is known, it includes what the slopes of the plane contribute to the place:
        over a part of the limb, they also absorb errors of the model, which move the ball.
        """
        groups = np.unique(self._spokes)
        if len(groups) < _FEWEST_GROUPS:
            return None
        normal, gradients = self._normal()
        sums = np.array([gradients[self._spokes == group].sum(axis=0) for group in groups])
        inverse = np.linalg.inv(normal)
        scatter = sums.T @ sums * (len(groups) / (len(groups) - 5)) + self._prior
        covariance: Float64 = (inverse @ scatter @ inverse)[:3, :3]
        if self._camera_known:
            by_slopes = inverse[:3, 3:] @ np.linalg.solve(inverse[3:, 3:], self.unknowns[3:])
            covariance += np.outer(by_slopes, by_slopes)
        shared = _SHARED_SIGMA_PX * max(_SMALL_PX / self.unknowns[2], 1.0) ** 2
        covariance += np.eye(3) * shared**2
        return covariance
