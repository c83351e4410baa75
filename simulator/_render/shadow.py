"""What stands between a point and a light: spheres, a height field, or a mesh.

A height field is walked on a grid of its heights, from one grid line to the next along the axis in
which the ray runs faster, and squares of 16 x 16 heights are passed over where the ray is above
them all. The grid is first lowered by the error of interpolating it, so that it lies nowhere above
the surface it stands for: then no point is shadowed by its own surroundings, and no bias is needed
that would let light leak in elsewhere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter, minimum_filter

from simulator._shapes.body import HeightGrid
from simulator._shapes.bvh import TriangleTree

Array = npt.NDArray[np.float64]
Values = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

_BLOCK = 1024
_ROWS = 256
_TILE = 16
# Neighbouring heights that differ by more than this many steps are the two sides of a wall.
_WALL = 4.0
# What the error of interpolation may be above its estimate from second differences.
_SPARE = 1.5
# A bend of this many steps within one step is not resolved by the grid.
_UNRESOLVED = 0.25
_ROUNDING = 1e-6
# Lifts the points of a mesh off their own triangles: far below a pixel, far above rounding.
_LIFT_MM = 1e-4


@dataclass(frozen=True, eq=False)
class Occluders:
    """All that casts shadows in a scene.

    Parameters
    ----------
    spheres
        ``(S, >= 4)`` rows of centre and radius.
    body
        The object, None where there is none.
    """

    spheres: Array
    body: HeightGrid | TriangleTree | None

    def occlude(
        self, light: Values, points_mm: Array, normals: Array, solid: Mask, lamps: Array, near: bool
    ) -> Mask:
        """Take away the light that does not arrive.

        Parameters
        ----------
        light
            ``(N, n)`` irradiance by lamps that nothing stands before; in place it becomes that of
            the part of each lamp that is seen.
        points_mm, normals
            ``(n, 3)``.
        solid
            ``(n,)`` points on which the body may cast its shadow.
        lamps
            ``(N, P, 3)`` places of P equal parts of each lamp in mm; directions toward them where
            not ``near``.
        near
            What ``lamps`` are.

        Returns
        -------
        Mask
            ``(N, n)`` True where no light came from the start, or less than half of a lamp is
            seen.
        """
        if self.body is None and not len(self.spheres):
            return light <= 0
        parts = lamps.shape[1]
        seen = np.zeros(light.shape, np.uint16)
        for part in range(parts):
            blocked = light <= 0
            toward = np.ascontiguousarray(lamps[:, part])
            if len(self.spheres) or isinstance(self.body, HeightGrid):
                self._block(blocked, points_mm, solid, toward, near)
            if isinstance(self.body, TriangleTree):
                _block_by_mesh(self.body, blocked, points_mm, normals, solid, toward, near)
            seen += ~blocked
        light *= seen * np.float32(1 / parts)
        dark: Mask = 2 * seen < parts
        return dark

    def _block(self, blocked: Mask, points: Array, solid: Mask, lamps: Array, near: bool) -> None:
        origin, step = (0.0, 0.0), 1.0
        if isinstance(self.body, HeightGrid):
            origin, step = self.body.origin_xy_mm, self.body.step_mm
        _block(
            blocked,
            points,
            solid,
            lamps,
            near,
            self.spheres,
            self._heights.ravel(),
            self._heights.shape[1],
            self._tiles,
            origin[0],
            origin[1],
            step,
            float(self._tiles.max(initial=-math.inf)),
        )

    @cached_property
    def _heights(self) -> Values:
        if isinstance(self.body, HeightGrid):
            return lowered(self.body)
        return np.zeros((0, 0), np.float32)

    @cached_property
    def _tiles(self) -> Values:
        """Highest heights of squares of the grid."""
        heights = self._heights
        for axis in range(2):
            edges = np.arange(0, heights.shape[axis], _TILE)
            if edges.size:
                heights = np.maximum.reduceat(heights, edges, axis=axis)
        return heights


def lowered(grid: HeightGrid) -> Values:
    """Return heights whose interpolation lies nowhere above the surface.

    The error of bilinear interpolation is at most an eighth of the second differences along x and
    y together. Those across a wall are left out: the walk puts walls at their inner side.
    """
    heights, wall = grid.heights_mm, _WALL * grid.step_mm
    out = np.zeros_like(heights)
    rounding = _ROUNDING * max(1.0, float(np.abs(heights).max(initial=0.0)))
    for start in range(0, len(heights), _ROWS):
        low, high = max(0, start - 2), min(len(heights), start + _ROWS + 2)
        band = heights[low:high]
        bend = np.zeros_like(band)
        for axis in range(2):
            second = np.abs(np.diff(band, 2, axis=axis))
            second[second > wall] = 0
            inner = [slice(None), slice(None)]
            inner[axis] = slice(1, -1)
            bend[tuple(inner)] += second
        sag = maximum_filter(bend, 3) * np.float32(_SPARE / 8)
        # Between heights this uneven the surface may do anything: only the least of them is safe.
        unresolved = sag > _UNRESOLVED * grid.step_mm
        sag[unresolved] = (band - minimum_filter(band, 3))[unresolved]
        stop = min(len(heights), start + _ROWS)
        part = slice(start - low, stop - low)
        out[start:stop] = band[part] - sag[part] - np.float32(rounding)
    return out


def _block_by_mesh(
    tree: TriangleTree,
    blocked: Mask,
    points: Array,
    normals: Array,
    solid: Mask,
    lamps: Array,
    near: bool,
) -> None:
    lifted = points + _LIFT_MM * normals
    for shaded, lamp in zip(blocked, lamps, strict=True):
        ask = np.flatnonzero(~shaded & solid)
        start = lifted[ask]
        way = lamp - start if near else np.broadcast_to(lamp, start.shape)
        shaded[ask] = tree.blocked(start, way, 1.0 if near else math.inf)


@numba.njit(cache=True)
def _sphere_between(
    px: float,
    py: float,
    pz: float,
    dx: float,
    dy: float,
    dz: float,
    reach: float,
    spheres: Array,
) -> bool:
    """Return whether a sphere stands on the way from p to p + reach * d."""
    d2 = dx * dx + dy * dy + dz * dz
    for j in range(len(spheres)):
        ox, oy, oz = spheres[j, 0] - px, spheres[j, 1] - py, spheres[j, 2] - pz
        along = ox * dx + oy * dy + oz * dz
        gap = ox * ox + oy * oy + oz * oz - along * along / d2
        if 0.0 < along < d2 * reach and gap < spheres[j, 3] ** 2:
            return True
    return False


@numba.njit(cache=True)
def _field_between(
    u: float,
    v: float,
    z: float,
    du: float,
    dv: float,
    dz: float,
    reach: float,
    heights: Values,
    columns: int,
    tiles: Values,
    top: float,
    wall: float,
) -> bool:
    """Return whether the field rises above the way from (u, v, z) on, u and v in grid steps."""
    along, across = 1, columns  # strides of the axis walked along, and of the other
    lines, others = columns, len(heights) // columns
    swapped = abs(dv) > abs(du)
    if swapped:
        u, v, du, dv = v, u, dv, du
        along, across, lines, others = across, along, others, lines
    if du == 0.0:
        return False  # straight up
    begin, end = 0.0, reach
    if dz > 0.0:
        end = min(end, (top - z) / dz)
    elif z > top:
        if dz == 0.0:
            return False
        begin = (top - z) / dz
    near_u, far_u = -u / du, (lines - 1 - u) / du
    begin, end = max(begin, min(near_u, far_u)), min(end, max(near_u, far_u))
    if dv != 0.0:
        near_v, far_v = -v / dv, (others - 1 - v) / dv
        begin, end = max(begin, min(near_v, far_v)), min(end, max(near_v, far_v))
    elif not 0.0 <= v <= others - 1:
        return False
    if not begin < end:
        return False
    sign = 1 if du > 0.0 else -1
    if sign > 0:
        line = math.floor(u + begin * du) + 1
        last = min(math.floor(u + end * du), lines - 1)
    else:
        line = math.ceil(u + begin * du) - 1
        last = max(math.ceil(u + end * du), 0)
    v_step, z_step = dv / abs(du), dz / abs(du)
    while sign * (last - line) >= 0:
        # As far as the end of this column of tiles.
        stop = min(line | (_TILE - 1), last) if sign > 0 else max(line & ~(_TILE - 1), last)
        count = sign * (stop - line) + 1
        t = (line - u) / du
        w, h = v + t * dv, z + t * dz
        w_end, h_end = w + v_step * (count - 1), h + z_step * (count - 1)
        first = max(int(min(w, w_end)), 0) // _TILE
        final = min(int(max(w, w_end)) + 1, others - 1) // _TILE
        peak = -math.inf
        for tile in range(first, final + 1):
            highest = tiles[line // _TILE, tile] if swapped else tiles[tile, line // _TILE]
            if highest > peak:
                peak = highest
        if min(h, h_end) < peak:
            for _ in range(count):
                m = min(max(int(w), 0), others - 2)
                place = line * along + m * across
                a, b = heights[place], heights[place + across]
                if (min(a, b) if abs(a - b) > wall else a + (w - m) * (b - a)) > h:
                    return True
                w, h = w + v_step, h + z_step
                line += sign
        else:
            line = stop + sign
    return False


@numba.njit(parallel=True, cache=True)
def _block(
    blocked: Mask,
    points: Array,
    solid: Mask,
    lamps: Array,
    near: bool,
    spheres: Array,
    heights: Values,
    columns: int,
    tiles: Values,
    origin_x: float,
    origin_y: float,
    step: float,
    top: float,
) -> None:
    count = len(points)
    for block in numba.prange((count + _BLOCK - 1) // _BLOCK):
        for k in range(len(lamps)):
            dx, dy, dz = lamps[k, 0], lamps[k, 1], lamps[k, 2]
            reach = 1.0 if near else math.inf
            for i in range(block * _BLOCK, min((block + 1) * _BLOCK, count)):
                if blocked[k, i]:
                    continue
                px, py, pz = points[i, 0], points[i, 1], points[i, 2]
                if near:
                    dx, dy, dz = lamps[k, 0] - px, lamps[k, 1] - py, lamps[k, 2] - pz
                if len(spheres) and _sphere_between(px, py, pz, dx, dy, dz, reach, spheres):
                    blocked[k, i] = True
                elif columns and solid[i]:
                    blocked[k, i] = _field_between(
                        (px - origin_x) / step,
                        (py - origin_y) / step,
                        pz,
                        dx / step,
                        dy / step,
                        dz,
                        reach,
                        heights,
                        columns,
                        tiles,
                        top,
                        _WALL * step,
                    )
