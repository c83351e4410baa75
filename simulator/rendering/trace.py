"""Trace camera rays to the object, the clutter or the board, directly or via the spheres."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numba
import numpy as np

from acquisition import DataError
from rig import in_threads
from rig.arrays import Bool, Float64, Int64
from rig.kernels import PART
from simulator.scene.clutter import BALL
from simulator.scene.scene import Scene

# Compiled in: rig/kernels/parts.py 986f6e8c38a7
# Compiled in: simulator/scene/clutter.py 1dcce88b9e5d

_BOUNCES = 4
# Steps of the search for the relief of the board. Each one divides the error by the product of the
# slopes of relief and ray, so that a ray 20 degrees from the axis needs about 25 on the steepest.
_RELIEF_STEPS, _RELIEF_MM = 40, 1e-9


@dataclass(frozen=True, eq=False)
class Seen:
    """Points that n camera rays see.

    Parameters
    ----------
    points_mm, normals
        ``(n, 3)`` end point of each ray, and the unit normal there.
    on_object
        ``(n,)`` True if the point has the albedo of the object, not of the board.
    sphere
        ``(n,)`` first sphere that the ray hits, -1 if it hits none.
    lost
        ``(n,)`` True if the ray left the spheres upward, into the surroundings.
    weight
        ``(n,)`` product of the reflectances of the spheres that the ray hits, 1 without spheres.
    item
        ``(n,)`` index of the clutter on which the ray ends, -1 if it ends elsewhere.
    depth_mm
        ``(n,)`` depth of what the ray sees below the camera. A sphere shows virtual images, less
        than half its radius behind its surface; their depth is that of the tangential focus.
    """

    points_mm: Float64
    normals: Float64
    on_object: Bool
    sphere: Int64
    lost: Bool
    weight: Float64
    item: Int64
    depth_mm: Float64

    def at(self, pick: Int64 | Bool) -> Seen:
        """Return some of the points."""
        return Seen(**{part.name: getattr(self, part.name)[pick] for part in fields(self)})

    @property
    def direct(self) -> Bool:
        """``(n,)`` True if the ray hits no sphere."""
        return self.sphere < 0


def see(scene: Scene, origins_mm: Float64, rays: Float64) -> Seen:
    """Trace camera rays to their end points.

    Rays that a sphere mirrors ignore the height of the object and the relief of the board: they end
    on the plane of the board, as if there were a flat picture of the object. Clutter is mirrored
    where it is.

    Parameters
    ----------
    scene
        The scene.
    origins_mm, rays
        ``(n, 3)`` each, rays scaled to z = -1.

    Returns
    -------
    Seen
        End points, to 1e-9 mm.

    Raises
    ------
    DataError
        If the object cannot be traced or hides part of a sphere.
    """
    # End points on the board; those of rays that hit something else are replaced below.
    points = origins_mm + origins_mm[:, 2:] * rays
    points[:, 2] = 0.0
    normals = np.zeros(points.shape)
    normals[:, 2] = 1.0
    on_object = np.zeros(len(points), np.bool_)
    count = len(rays)
    sphere, entry_mm = np.full(count, -1, np.int64), np.full(count, -math.inf)
    lost, weight = np.zeros(count, np.bool_), np.ones(count)
    item, behind_mm = np.full(count, -1, np.int64), np.zeros(count)
    if scene.spheres or scene.clutter:
        in_threads(
            _follow,
            len(rays),
            origins_mm, rays, scene.sphere_table, scene.clutter_table,
            sphere, entry_mm, lost, points, normals, weight, item, behind_mm,
        )  # fmt: skip
    if scene.body is not None:
        hits = scene.body.trace(origins_mm, rays)
        before = hits.hit & (hits.points_mm[:, 2] > entry_mm)
        if (before & (sphere >= 0)).any():
            hidden = sphere[np.argmax(before & (sphere >= 0))]
            raise DataError(
                f"the object hides part of sphere {hidden} from the camera: move the sphere outward"
            )
        mirrored = scene.body.inside(points[:, 0], points[:, 1]) & (item < 0)
        met = before & (sphere < 0)
        on_object = np.where(sphere < 0, met, mirrored)
        points[met], normals[met], item[met] = hits.points_mm[met], hits.normals[met], -1
    if scene.relief is not None:
        _meet_relief(scene, origins_mm, rays, ~on_object & (item < 0), sphere < 0, points, normals)
    ends = np.where(sphere < 0, points[:, 2], entry_mm - behind_mm)
    depth = scene.lens.camera_z_mm - ends
    return Seen(points, normals, on_object, sphere, lost, weight, item, depth)


def _meet_relief(
    scene: Scene,
    origins_mm: Float64,
    rays: Float64,
    on_board: Bool,
    direct: Bool,
    points: Float64,
    normals: Float64,
) -> None:
    """Move direct points of the board to its relief, and give all its points their normals."""
    ask = np.flatnonzero(on_board & direct)
    for _ in range(_RELIEF_STEPS):
        before = points[ask, :2]
        height, _ = scene.relief_at(before[:, 0], before[:, 1])
        points[ask] = origins_mm[ask] + (origins_mm[ask, 2] - height)[:, None] * rays[ask]
        # Each point stops on its own, so that it does not depend on the others.
        ask = ask[np.abs(points[ask, :2] - before).max(axis=1) >= _RELIEF_MM]
        if not ask.size:
            break
    normals[on_board] = scene.relief_at(points[on_board, 0], points[on_board, 1])[1]


def meets(scene: Scene, origins_mm: Float64, rays: Float64) -> Bool:
    """Return which camera rays ``(n, 3)`` hit a sphere or clutter."""
    met = np.zeros(len(rays), np.bool_)
    in_threads(_meets, len(rays), origins_mm, rays, scene.sphere_table, scene.clutter_table, met)
    return met


@numba.njit(**PART)
def _ball_ahead(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, balls: Float64, j: int
) -> float:
    """Return the way along the unit direction d to a ball: a row of centre, radius; or infinity."""
    ox, oy, oz = px - balls[j, 0], py - balls[j, 1], pz - balls[j, 2]
    b = ox * dx + oy * dy + oz * dz
    root = b * b - (ox * ox + oy * oy + oz * oz - balls[j, 3] ** 2)
    # b < 0: the ball is ahead. This also keeps a ray from hitting the one that it has just left.
    return -b - math.sqrt(root) if root > 0.0 and b < 0.0 else math.inf


@numba.njit(**PART)
def _box_ahead(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, box: Float64
) -> tuple[float, int, float]:
    """Return the way to a box or infinity, the axis of the face, and the sign of its normal."""
    cosine, sine = box[7], box[8]
    x, y, z = px - box[1], py - box[2], pz - box[3]
    begin, end, face, sign = -math.inf, math.inf, 0, 1.0
    for axis in range(3):
        if axis == 0:
            start, way = cosine * x + sine * y, cosine * dx + sine * dy
        elif axis == 1:
            start, way = cosine * y - sine * x, cosine * dy - sine * dx
        else:
            start, way = z, dz
        half = box[4 + axis]
        if way == 0.0:
            if abs(start) > half:
                return math.inf, 0, 1.0
            continue
        one, two = (-half - start) / way, (half - start) / way
        if min(one, two) > begin:
            begin, face, sign = min(one, two), axis, -1.0 if way > 0.0 else 1.0
        end = min(end, max(one, two))
    return (begin, face, sign) if 0.0 < begin < end else (math.inf, 0, 1.0)


@numba.njit(**PART)
def _clutter_ahead(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, clutter: Float64
) -> tuple[float, int]:
    """Return the way to the nearest piece of clutter, and its index; infinity and -1 for none."""
    best, hit = math.inf, -1
    for j in range(len(clutter)):
        if clutter[j, 0] == BALL:
            way = _ball_ahead(px, py, pz, dx, dy, dz, clutter[:, 1:5], j)
        else:
            way = _box_ahead(px, py, pz, dx, dy, dz, clutter[j])[0]
        if way < best:
            best, hit = way, j
    return best, hit


@numba.njit(nogil=True, cache=True)
def _meets(
    first: int,
    last: int,
    origins: Float64,
    rays: Float64,
    spheres: Float64,
    clutter: Float64,
    met: Bool,
) -> None:
    for i in range(first, last):
        px, py, pz = origins[i, 0], origins[i, 1], origins[i, 2]
        dx, dy, dz = rays[i, 0], rays[i, 1], rays[i, 2]
        norm = math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / norm, dy / norm, dz / norm
        for j in range(len(spheres)):
            met[i] |= _ball_ahead(px, py, pz, dx, dy, dz, spheres, j) < math.inf
        met[i] |= _clutter_ahead(px, py, pz, dx, dy, dz, clutter)[1] >= 0


@numba.njit(nogil=True, cache=True)
def _follow(
    begin: int,
    end: int,
    origins: Float64,
    rays: Float64,
    spheres: Float64,
    clutter: Float64,
    first: Int64,
    entry: Float64,
    lost: Bool,
    points: Float64,
    normals: Float64,
    weight: Float64,
    item: Int64,
    behind: Float64,
) -> None:
    for i in range(begin, end):
        px, py, pz = origins[i, 0], origins[i, 1], origins[i, 2]
        dx, dy, dz = rays[i, 0], rays[i, 1], rays[i, 2]
        norm = math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / norm, dy / norm, dz / norm
        share, slant, cosine_in, curve = 1.0, 1.0, 1.0, 1.0
        sx, sy, sz = px, py, pz
        for bounce in range(_BOUNCES + 1):
            best, hit = math.inf, -1
            for j in range(len(spheres)):
                way = _ball_ahead(px, py, pz, dx, dy, dz, spheres, j)
                if way < best:
                    best, hit = way, j
            way, thing = _clutter_ahead(px, py, pz, dx, dy, dz, clutter)
            if way < best:
                item[i] = thing
                points[i, 0], points[i, 1], points[i, 2] = (
                    px + way * dx,
                    py + way * dy,
                    pz + way * dz,
                )
                if bounce == 0:
                    entry[i] = pz + way * dz
                if clutter[thing, 0] == BALL:
                    for axis in range(3):
                        gap = points[i, axis] - clutter[thing, 1 + axis]
                        normals[i, axis] = gap / clutter[thing, 4]
                else:
                    _, face, sign = _box_ahead(px, py, pz, dx, dy, dz, clutter[thing])
                    cosine, sine = sign * clutter[thing, 7], sign * clutter[thing, 8]
                    normals[i, 0] = cosine if face == 0 else -sine if face == 1 else 0.0
                    normals[i, 1] = sine if face == 0 else cosine if face == 1 else 0.0
                    normals[i, 2] = sign if face == 2 else 0.0
                break
            if hit < 0 or bounce == _BOUNCES:
                break
            px, py, pz = px + best * dx, py + best * dy, pz + best * dz
            if bounce == 0:
                first[i], entry[i] = hit, pz
            share *= spheres[hit, 4]
            nx = (px - spheres[hit, 0]) / spheres[hit, 3]
            ny = (py - spheres[hit, 1]) / spheres[hit, 3]
            nz = (pz - spheres[hit, 2]) / spheres[hit, 3]
            turn = 2.0 * (dx * nx + dy * ny + dz * nz)
            if bounce == 0:
                sx, sy, sz = px, py, pz
                slant, cosine_in, curve = -dz, -turn / 2.0, spheres[hit, 3]
            dx, dy, dz = dx - turn * nx, dy - turn * ny, dz - turn * nz
        if first[i] >= 0:
            weight[i] = share
            away = math.inf
            if item[i] < 0 and dz > -1e-9:
                lost[i] = True
            else:
                if item[i] < 0:
                    points[i, 0] = px - dx / dz * pz
                    points[i, 1] = py - dy / dz * pz
                away = math.sqrt(
                    (points[i, 0] - sx) ** 2 + (points[i, 1] - sy) ** 2 + (points[i, 2] - sz) ** 2
                )
            # The tangential focus of the first sphere, 1/image = 1/object + 2 / (R cos t).
            focus = max(cosine_in, 1e-6) * curve / 2.0
            behind[i] = slant / (1.0 / focus + 1.0 / max(away, 1e-6))
