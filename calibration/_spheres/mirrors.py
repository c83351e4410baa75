"""Search for the ball around a cluster of highlights that mirrors its surroundings best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acquisition import CameraModel
from calibration._spheres.ellipse import Ellipse, fit_circle, fit_ellipse
from calibration._spheres.robust import Array
from calibration._spheres.spots import SpotCluster
from calibration._spheres.surroundings import Balls, Likeness, MirroredPlane, outlines_of

# Highlights are within this share of the radius, see highlights.py; one in ten may be false.
_FARTHEST_SPOT = 0.87
_TRUE_SPOTS = 0.9
_LARGEST = 6.0
_LARGEST_SHARE = 0.6
_STEP = 0.08
_RADIUS_STEP = 1.06
_COARSE_SPOKES = 24
_LEADERS = 4
_MOST_MOVES = 16
_NEAR_STEPS, _NEAR_REACH = 5, 1.5
# Expected radii hold for spheres near the working plane.
_EXPECTED = 0.15
# Of true spheres the share is 0.79 to 0.96; chance explains up to 0.6 where little is seen.
LEAST_SHARE = 0.7
# Blur and neighbours reduce the share of small spheres to 0.5 to 0.8, which is enough if the ball
# has an expected radius.
_SMALL_PX, _FAIR_SHARE = 30.0, 0.5
_LEAST_SEEN = 0.35
_LEAST_CONTRAST = 2.0
# Black velvet hardly differs between lights: less is enough for a ball of an expected radius.
_FAIR_CONTRAST = 1.3
# The fit uses the limb from a fifth of the radius inside to two pixels inside the outline, where
# blur does not mix it with the plane.
_INNERMOST = 0.8
_MARGIN_PX = 2.0
_FINE_SPOKES = 72
_SPOKES_TOGETHER = 3
# Errors of the model that all spokes share, of place and radius; measured on simulated boards.
_SHARED_SIGMA_PX = 0.04
_FIT_ROUNDS = 12
_CLOSE_PX, _CONVERGED_PX = 0.03, 0.004
_FEWEST_DIFFERENCES = 100
_FEWEST_GROUPS = 8
_SLOPE, _SLOPE_WITHOUT_CAMERA = 0.02, 0.1
# A pixel averages over a Gaussian: itself, the lens and the interpolation.
_USUAL_BLUR_PX = 0.9
_BLURS_PX = (0.5, 0.65, 0.9, 1.2, 1.6)
_SPREAD = 0.8 * np.arange(-2.0, 3.0)
_SPREAD_SHARES = np.exp(-0.5 * _SPREAD**2)
_SPREAD_SHARES /= _SPREAD_SHARES.sum()


@dataclass(frozen=True, eq=False)
class Mirror:
    """A ball that mirrors its surroundings.

    Parameters
    ----------
    ball
        The ball, to about 1 % of its radius.
    share
        Share of the differences near its limb that the mirrored plane explains.
    """

    ball: Balls
    share: float

    def outline(self, camera: CameraModel) -> Ellipse:
        """Return the outline of the ball."""
        return outline_of(camera, self.ball)


def find_mirror(
    plane: MirroredPlane, cluster: SpotCluster, radii_px: Sequence[float] = ()
) -> Mirror | None:
    """Return the ball that mirrors the plane around it best, or None if none mirrors it well.

    All balls are tried whose outline has the highlights inside, first on a grid of 8 % of the
    radius, then finer around the best ones.

    Parameters
    ----------
    plane
        The images.
    cluster
        Highlights of the ball.
    radii_px
        Expected radii, to 15 %. Default: any radius.
    """
    best = best_mirror(plane, cluster, radii_px)
    if best is None:
        return None
    mirror = _accepted(*best)
    if mirror is None and len(radii_px):
        mirror = _accepted(*best, least_contrast=_FAIR_CONTRAST)
        if mirror is None and best[0].radii_px[0] < _SMALL_PX:
            mirror = _accepted(*best, least_share=_FAIR_SHARE)
    return mirror


def best_mirror(
    plane: MirroredPlane, cluster: SpotCluster, radii_px: Sequence[float] = ()
) -> tuple[Balls, Likeness] | None:
    """Return the best ball around a cluster, however well it mirrors the plane.

    Parameters are those of `find_mirror`; the result is None if no ball has the highlights inside.
    """
    leaders = _leaders(plane, cluster, radii_px)
    return max(
        (_climb(plane, ball) for ball in leaders),
        key=lambda pair: float(pair[1].share[0]),
        default=None,
    )


def mirror_near(plane: MirroredPlane, circle: Ellipse, reach_px: float) -> Mirror | None:
    """Return the ball near a circle that mirrors the plane around it, or None if none does.

    Parameters
    ----------
    plane
        The images.
    circle
        The approximate outline.
    reach_px
        Largest error of its centre and of its radius.
    """
    start = np.append(circle.centre_px, circle.radius_px)
    steps = np.linspace(-1, 1, _NEAR_STEPS) * reach_px
    grid = start + np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    # Balls that are compared together must be of similar size.
    tables = [grid[grid[:, 2] == radius] for radius in np.unique(grid[:, 2]) if radius > 2]
    scores = [
        np.where(compared.seen > _LEAST_SEEN, compared.share, -np.inf)
        for compared in (
            plane.compare(Balls(table[:, :2], table[:, 2]), _COARSE_SPOKES) for table in tables
        )
    ]
    if not tables:
        return None
    best = np.concatenate(tables)[int(np.argmax(np.concatenate(scores)))]
    ball, likeness = _climb(plane, Balls(best[None, :2], best[None, 2]))
    moved = np.abs(np.append(ball.axes_px[0], ball.radii_px) - start)
    return None if moved.max() > _NEAR_REACH * reach_px else _accepted(ball, likeness)


def _accepted(
    ball: Balls,
    likeness: Likeness,
    *,
    least_share: float = LEAST_SHARE,
    least_contrast: float = _LEAST_CONTRAST,
) -> Mirror | None:
    """Return a ball if it mirrors the plane well."""
    enough = likeness.share[0] >= least_share and likeness.seen[0] >= _LEAST_SEEN
    if not (enough and likeness.contrast[0] >= least_contrast):
        return None
    return Mirror(ball, float(likeness.share[0]))


def _leaders(plane: MirroredPlane, cluster: SpotCluster, radii_px: Sequence[float]) -> list[Balls]:
    """Return the best balls of a coarse grid that are apart from each other."""
    rows: list[Array] = []
    for radius in _radii(plane, cluster, radii_px):
        centres = _centres(cluster, radius)
        if not len(centres):
            continue
        likeness = plane.compare(Balls(centres, np.full(len(centres), radius)), _COARSE_SPOKES)
        score = np.where(likeness.seen > _LEAST_SEEN, likeness.share, -np.inf)
        rows.append(np.column_stack([centres, np.full(len(centres), radius), score]))
    if not rows:
        return []
    table = np.concatenate(rows)
    leaders: list[Array] = []
    for row in table[np.argsort(-table[:, 3])][:400]:
        apart = all(
            np.hypot(*(row[:2] - other[:2])) > 0.12 * row[2] or abs(row[2] / other[2] - 1) > 0.1
            for other in leaders
        )
        if apart and np.isfinite(row[3]):
            leaders.append(row)
        if len(leaders) == _LEADERS:
            break
    return [Balls(row[None, :2], row[None, 2]) for row in leaders]


def _radii(plane: MirroredPlane, cluster: SpotCluster, radii_px: Sequence[float]) -> Array:
    """Return the radii to try."""
    smallest = max(cluster.reach_px, 2.0) / _FARTHEST_SPOT
    side = min(plane.camera.width, plane.camera.height)
    largest = min(_LARGEST * cluster.reach_px, _LARGEST_SHARE * side)
    count = max(int(np.log(max(largest / smallest, 1)) / np.log(_RADIUS_STEP)) + 1, 1)
    radii: Array = smallest * _RADIUS_STEP ** np.arange(count, dtype=np.float64)
    if len(radii_px):
        off = np.abs(radii[:, None] / np.asarray(radii_px) - 1)
        radii = radii[off.min(axis=1) < _EXPECTED + _RADIUS_STEP - 1]
    return radii


def _centres(cluster: SpotCluster, radius: float) -> Array:
    """Return a grid of centres from which the highlights are within reach."""
    step = max(_STEP * radius, 1.0)
    reach = _FARTHEST_SPOT * radius
    steps = np.arange(-reach, reach + step, step)
    x, y = (v.ravel() for v in np.meshgrid(steps, steps))
    centres = cluster.centre_px + np.column_stack([x, y])
    gaps = np.linalg.norm(centres[:, None] - cluster.spots_px, axis=2)
    kept: Array = centres[np.quantile(gaps, _TRUE_SPOTS, axis=1) < reach]
    return kept


def _climb(plane: MirroredPlane, start: Balls) -> tuple[Balls, Likeness]:
    """Move a ball to the best place nearby, with steps from 4 % down to a quarter of a percent."""
    grid = np.stack(np.meshgrid([0, -1, 1], [0, -1, 1], [0, -1, 1]), axis=-1).reshape(-1, 3)
    ball, step = np.append(start.axes_px[0], start.radii_px[0]), 0.04
    for _ in range(_MOST_MOVES):
        trial = ball + grid * step * ball[2]
        compared = plane.compare(Balls(trial[:, :2], trial[:, 2]), _COARSE_SPOKES)
        best = int(np.argmax(np.where(compared.seen > _LEAST_SEEN, compared.share, -np.inf)))
        ball = trial[best]
        if not grid[best].any():
            step /= 2
            if step < 0.002:
                break
    found = Balls(ball[None, :2], ball[None, 2])
    return found, plane.compare(found)


def outline_of(camera: CameraModel, ball: Balls) -> Ellipse:
    """Return the outline of one ball."""
    points = outlines_of(camera, ball, 60)[0]
    circle, _ = fit_circle(points)
    return fit_ellipse(points, circle)[0]


@dataclass(frozen=True, eq=False)
class FittedBall:
    """A ball whose outline is known to a few hundredths of a pixel.

    Parameters
    ----------
    ball
        The ball.
    covariance_px2
        ``(3, 3)`` covariance of centre x, centre y and radius of its outline.
    """

    ball: Balls
    covariance_px2: Array


def fit_mirror(plane: MirroredPlane, mirror: Mirror) -> FittedBall | None:
    """Fit place and radius of a ball to what it mirrors, by robust least squares.

    Unknowns are also the slopes of the plane, which make up for a board that is not at a right
    angle to the camera's axis, or for an unknown camera. The blur is the one with the smallest
    differences. The covariance contains errors of the model: neighbouring spokes of the ball share
    them, so groups of spokes, not samples, count as independent. Returns None if the fit moves the
    ball by more than a twentieth of its radius, or makes it worse.
    """
    size = float(mirror.ball.radii_px[0])
    start = np.concatenate([mirror.ball.axes_px[0], mirror.ball.radii_px, [0.0, 0.0]])
    trial = _MirrorFit(plane, start, _USUAL_BLUR_PX)
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
    return FittedBall(ball, covariance)


class _MirrorFit:
    """Differences between a ball's limb and what it should mirror, and their derivatives."""

    def __init__(self, plane: MirroredPlane, unknowns: Array, blur_px: float) -> None:
        self.unknowns, self.blur_px = unknowns, blur_px
        size = float(unknowns[2])
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
    def balls(unknowns: Array) -> Balls:
        """Return the balls of unknowns ``(H, 5)``."""
        return Balls(unknowns[:, :2], unknowns[:, 2], unknowns[:, 3:])

    def _normal(self) -> tuple[Array, Array]:
        """Return the normal matrix ``(5, 5)`` and the gradient ``(points, 5)`` of each point."""
        weight = 1 / (self.scale * (1 + (self._first / (2 * self.scale)) ** 2)) ** 2
        weighted = self._slopes * weight[..., None]
        normal: Array = np.einsum("cpi,cpj->ij", weighted, self._slopes) + self._prior
        return normal, np.einsum("cpi,cp->pi", weighted, self._first)

    def move(self) -> Array | None:
        """Return the next step of the unknowns; None if too little of the limb can be compared."""
        if self._first.size < _FEWEST_DIFFERENCES:
            return None
        normal, gradients = self._normal()
        step = -np.linalg.solve(normal, gradients.sum(axis=0) + self._prior @ self.unknowns)
        limit = np.array([*[0.02 * self.unknowns[2]] * 3, 0.05, 0.05])
        limited: Array = np.clip(step, -limit, limit)
        return limited

    def covariance(self) -> Array | None:
        """Return the covariance ``(3, 3)`` of place and radius, None if it is undetermined."""
        groups = np.unique(self._spokes)
        if len(groups) < _FEWEST_GROUPS:
            return None
        normal, gradients = self._normal()
        sums = np.array([gradients[self._spokes == group].sum(axis=0) for group in groups])
        inverse = np.linalg.inv(normal)
        scatter = sums.T @ sums * (len(groups) / (len(groups) - 5)) + self._prior
        covariance: Array = (inverse @ scatter @ inverse)[:3, :3]
        return covariance + np.eye(3) * _SHARED_SIGMA_PX**2
