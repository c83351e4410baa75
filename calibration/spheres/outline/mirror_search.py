"""Search for the ball around a cluster of highlights that mirrors its surroundings best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acquisition import CameraModel
from calibration.spheres.geometry.ellipse import Ellipse, fit_circle, fit_ellipse
from calibration.spheres.highlights.spots import SpotCluster
from calibration.spheres.outline.surroundings import Balls, Likeness, MirroredPlane, outlines_of
from rig.arrays import Float64

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
# Of true spheres the share is 0.54 to 0.96; neighbours and blur reduce it. At places without a
# sphere, it is below 0.6 with one exception of 0.82.
LEAST_SHARE = 0.5
# A ball whose radius differs by 6 % explains at least 0.27 less than a true sphere. At places
# without a sphere, the share changes by at most 0.05 if it is above 0.45.
_OTHER_RADIUS, _LEAST_FALL = 0.06, 0.2
_LEAST_SEEN = 0.35
_LEAST_CONTRAST = 2.0
# Black velvet hardly differs between lights: less is enough for a ball of an expected radius.
_FAIR_SHARE, _FAIR_CONTRAST = 0.7, 1.3


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
    mirror = accepted(plane, *best)
    share, contrast = float(best[1].share[0]), float(best[1].contrast[0])
    if mirror is None and len(radii_px) and share >= _FAIR_SHARE and contrast >= _FAIR_CONTRAST:
        return Mirror(best[0], share)
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
    scores = [_scores(plane, Balls(table[:, :2], table[:, 2])) for table in tables]
    if not tables:
        return None
    best = np.concatenate(tables)[int(np.argmax(np.concatenate(scores)))]
    ball, likeness = _climb(plane, Balls(best[None, :2], best[None, 2]))
    moved = np.abs(np.append(ball.axes_px[0], ball.radii_px) - start)
    return None if moved.max() > _NEAR_REACH * reach_px else accepted(plane, ball, likeness)


def accepted(plane: MirroredPlane, ball: Balls, likeness: Likeness) -> Mirror | None:
    """Return a ball if it mirrors the plane well, and much better than balls of other radii."""
    share = float(likeness.share[0])
    enough = share >= LEAST_SHARE and likeness.seen[0] >= _LEAST_SEEN
    if not (enough and likeness.contrast[0] >= _LEAST_CONTRAST):
        return None
    radii = ball.radii_px * [1 - _OTHER_RADIUS, 1 + _OTHER_RADIUS]
    others = plane.compare(Balls(np.repeat(ball.axes_px, 2, axis=0), radii))
    return Mirror(ball, share) if share - others.share.max() >= _LEAST_FALL else None


def _leaders(plane: MirroredPlane, cluster: SpotCluster, radii_px: Sequence[float]) -> list[Balls]:
    """Return the best balls of a coarse grid that are apart from each other."""
    rows: list[Float64] = []
    for radius in _radii(plane, cluster, radii_px):
        centres = _centres(cluster, radius)
        if not len(centres):
            continue
        radii = np.full(len(centres), radius)
        rows.append(np.column_stack([centres, radii, _scores(plane, Balls(centres, radii))]))
    if not rows:
        return []
    table = np.concatenate(rows)
    leaders: list[Float64] = []
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


def _radii(plane: MirroredPlane, cluster: SpotCluster, radii_px: Sequence[float]) -> Float64:
    """Return the radii to try."""
    smallest = max(cluster.reach_px, 2.0) / _FARTHEST_SPOT
    side = min(plane.camera.width, plane.camera.height)
    largest = min(_LARGEST * cluster.reach_px, _LARGEST_SHARE * side)
    count = max(int(np.log(max(largest / smallest, 1)) / np.log(_RADIUS_STEP)) + 1, 1)
    radii: Float64 = smallest * _RADIUS_STEP ** np.arange(count, dtype=np.float64)
    if len(radii_px):
        off = np.abs(radii[:, None] / np.asarray(radii_px) - 1)
        radii = radii[off.min(axis=1) < _EXPECTED + _RADIUS_STEP - 1]
    return radii


def _centres(cluster: SpotCluster, radius: float) -> Float64:
    """Return a grid of centres from which the highlights are within reach."""
    step = max(_STEP * radius, 1.0)
    reach = _FARTHEST_SPOT * radius
    steps = np.arange(-reach, reach + step, step)
    x, y = (v.ravel() for v in np.meshgrid(steps, steps))
    centres = cluster.centre_px + np.column_stack([x, y])
    gaps = np.linalg.norm(centres[:, None] - cluster.spots_px, axis=2)
    return np.asarray(centres[np.quantile(gaps, _TRUE_SPOTS, axis=1) < reach])


def _climb(plane: MirroredPlane, start: Balls) -> tuple[Balls, Likeness]:
    """Move a ball to the best place nearby, with steps from 4 % down to a quarter of a percent."""
    grid = np.stack(np.meshgrid([0, -1, 1], [0, -1, 1], [0, -1, 1]), axis=-1).reshape(-1, 3)
    ball, step = np.append(start.axes_px[0], start.radii_px[0]), 0.04
    for _ in range(_MOST_MOVES):
        trial = ball + grid * step * ball[2]
        best = int(np.argmax(_scores(plane, Balls(trial[:, :2], trial[:, 2]))))
        ball = trial[best]
        if not grid[best].any():
            step /= 2
            if step < 0.002:
                break
    found = Balls(ball[None, :2], ball[None, 2])
    return found, plane.compare(found)


def _scores(plane: MirroredPlane, balls: Balls) -> Float64:
    """Return what the mirrored plane explains of each ball; none if too little of it is seen."""
    likeness = plane.compare(balls, _COARSE_SPOKES)
    return np.where(likeness.seen > _LEAST_SEEN, likeness.share, -np.inf)


def outline_of(camera: CameraModel, ball: Balls) -> Ellipse:
    """Return the outline of one ball."""
    points = outlines_of(camera, ball, 60)[0]
    circle, _ = fit_circle(points)
    return fit_ellipse(points, circle)[0]
