"""Search for the ball around a cluster of highlights that mirrors its surroundings best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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
_LEAST_SHARE = 0.5
_LEAST_SEEN = 0.25
_LEAST_CONTRAST = 2.0


@dataclass(frozen=True, eq=False)
class Mirror:
    """A ball that mirrors its surroundings.

    Parameters
    ----------
    outline
        Its approximate outline, to about 1 % of its radius.
    share
        Share of the differences near its limb that the mirrored plane explains.
    """

    outline: Ellipse
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
    points = outlines_of(plane.camera, best, 60)[0]
    circle, _ = fit_circle(points)
    outline, _ = fit_ellipse(points, circle)
    return Mirror(outline, float(likeness.share[0]))


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
    radii: Array = smallest * _RADIUS_STEP ** np.arange(count)
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
