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
# Expected radii hold for spheres near the working plane.
_EXPECTED = 0.15
# Of true spheres the share is 0.79 to 0.96; chance explains up to 0.6 where little is seen.
_LEAST_SHARE = 0.7
_LEAST_SEEN = 0.35
_LEAST_CONTRAST = 2.0
# The fit uses the limb from a fifth of the radius inside to two pixels inside the outline, where
# blur does not mix it with the plane.
_INNERMOST = 0.8
_MARGIN_PX = 2.0
_FINE_SPOKES = 72
_FIT_ROUNDS = 8
_SLOPE, _SLOPE_WITHOUT_CAMERA = 0.02, 0.1
# A pixel averages over a Gaussian of 0.9 px: itself, the interpolation and a usual lens.
_SPREAD_PX = 0.72 * np.arange(-2.0, 3.0)
_SPREAD = np.exp(-0.5 * (_SPREAD_PX / 0.9) ** 2)
_SPREAD /= _SPREAD.sum()


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
    leaders = _leaders(plane, cluster, radii_px)
    if not leaders:
        return None
    best, likeness = max(
        (_climb(plane, ball) for ball in leaders), key=lambda pair: float(pair[1].share[0])
    )
    if likeness.share[0] < _LEAST_SHARE or likeness.seen[0] < _LEAST_SEEN:
        return None
    if likeness.contrast[0] < _LEAST_CONTRAST:
        return None
    return Mirror(best, float(likeness.share[0]))


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


def fit_mirror(plane: MirroredPlane, mirror: Mirror) -> Balls | None:
    """Fit place and radius of a ball to what it mirrors, by robust least squares.

    Unknowns are also the slopes of the plane, which make up for a board that is not at a right
    angle to the camera's axis, or for an unknown camera. Returns None if the fit moves the ball by
    more than a twentieth of its radius, or makes it worse.
    """
    ball = mirror.ball
    slope = _SLOPE if plane.camera_known else _SLOPE_WITHOUT_CAMERA
    size = float(ball.radii_px[0])
    unknowns = np.concatenate([ball.axes_px[0], ball.radii_px, [0.0, 0.0]])
    steps = np.array([*[0.02 * max(size / 40, 1)] * 3, 0.002, 0.002])
    prior = np.diag([0.0, 0.0, 0.0, slope**-2, slope**-2])
    depths = np.linspace(_INNERMOST, max(1 - _MARGIN_PX / size, _INNERMOST + 0.03), 8)
    for _ in range(_FIT_ROUNDS):
        trial = unknowns + np.vstack([np.zeros(5), np.diag(steps)])
        balls = Balls(trial[:, :2], trial[:, 2], trial[:, 3:])
        differences, use = plane.differences(balls, depths, _FINE_SPOKES, _SPREAD_PX, _SPREAD)
        seen = use.all(axis=0)
        first = differences[:, 0][:, seen].ravel()
        if len(first) < 100:
            break
        slopes = np.stack(
            [differences[:, k + 1][:, seen].ravel() - first for k in range(5)], axis=1
        )
        slopes /= steps
        scale = max(1.4826 * float(np.median(np.abs(first))), 0.3)
        weighted = slopes / (1 + (first / (2 * scale)) ** 2)[:, None]
        normal = weighted.T @ slopes / scale**2 + prior
        move = -np.linalg.solve(normal, weighted.T @ first / scale**2 + prior @ unknowns)
        limit = np.array([*[0.02 * size] * 3, 0.05, 0.05])
        unknowns = unknowns + np.clip(move, -limit, limit)
        if np.abs(move[:3]).max() < 0.003:
            break
    fitted = Balls(unknowns[None, :2], unknowns[2:3], unknowns[None, 3:])
    moved = np.abs(unknowns[:3] - np.append(ball.axes_px[0], size)).max()
    if not (moved < 0.05 * size and plane.compare(fitted).share[0] > mirror.share - 0.1):
        return None
    return fitted
