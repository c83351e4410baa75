"""Shadow rays: from points toward lights, past spheres and boxes and over a grid of heights.

A ray over a height field advances from one grid line to the next along the axis in which it moves
faster. Tiles of 16 x 16 heights are skipped if the ray is above all of them.

All kernels are in one file because numba's cache does not notice changes of a kernel in another
file.
"""

from __future__ import annotations

import math

import numba

from rig.arrays import Bool, Float32, Float64
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

TILE = 16
# Neighbouring heights that differ by more than this many steps are the two sides of a wall.
WALL = 4.0
BLOCK = 1024


@numba.njit(**PART)
def _sphere_between(
    px: float,
    py: float,
    pz: float,
    dx: float,
    dy: float,
    dz: float,
    reach: float,
    spheres: Float64,
) -> bool:
    """Return whether a sphere blocks the line from p to p + reach * d."""
    d2 = dx * dx + dy * dy + dz * dz
    for j in range(len(spheres)):
        ox, oy, oz = spheres[j, 0] - px, spheres[j, 1] - py, spheres[j, 2] - pz
        along = ox * dx + oy * dy + oz * dz
        gap = ox * ox + oy * oy + oz * oz - along * along / d2
        if 0.0 < along < d2 * reach and gap < spheres[j, 3] ** 2:
            return True
    return False


@numba.njit(**PART)
def _box_between(
    px: float,
    py: float,
    pz: float,
    dx: float,
    dy: float,
    dz: float,
    reach: float,
    boxes: Float64,
) -> bool:
    """Return whether a box blocks the line from p to p + reach * d; its own face does not."""
    for j in range(len(boxes)):
        cosine, sine = boxes[j, 6], boxes[j, 7]
        x, y, z = px - boxes[j, 0], py - boxes[j, 1], pz - boxes[j, 2]
        begin, end = 0.0, reach
        for axis in range(3):
            if axis == 0:
                start, way = cosine * x + sine * y, cosine * dx + sine * dy
            elif axis == 1:
                start, way = cosine * y - sine * x, cosine * dy - sine * dx
            else:
                start, way = z, dz
            # Rounding must not place a point of a face inside.
            half = boxes[j, 3 + axis] - 1e-6
            if way == 0.0:
                if abs(start) >= half:
                    end = -1.0
                continue
            one, two = (-half - start) / way, (half - start) / way
            begin, end = max(begin, min(one, two)), min(end, max(one, two))
        if begin < end:
            return True
    return False


@numba.njit(**PART)
def _field_between(
    u: float,
    v: float,
    z: float,
    du: float,
    dv: float,
    dz: float,
    reach: float,
    heights: Float32,
    columns: int,
    tiles: Float32,
    top: float,
    wall: float,
) -> bool:
    """Return whether the field blocks the ray from (u, v, z), with u and v in grid steps."""
    along, across = 1, columns  # strides of the axis of the walk, and of the other axis
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
        # To the end of this column of tiles.
        stop = min(line | (TILE - 1), last) if sign > 0 else max(line & ~(TILE - 1), last)
        count = sign * (stop - line) + 1
        t = (line - u) / du
        w, h = v + t * dv, z + t * dz
        w_end, h_end = w + v_step * (count - 1), h + z_step * (count - 1)
        first = max(int(min(w, w_end)), 0) // TILE
        final = min(int(max(w, w_end)) + 1, others - 1) // TILE
        peak = -math.inf
        for tile in range(first, final + 1):
            highest = tiles[line // TILE, tile] if swapped else tiles[tile, line // TILE]
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


@numba.njit(nogil=True, cache=True)
def block(
    first: int,
    last: int,
    blocked: Bool,
    points: Float64,
    solid: Bool,
    lamps: Float64,
    near: bool,
    spheres: Float64,
    boxes: Float64,
    heights: Float32,
    columns: int,
    tiles: Float32,
    origin_x: float,
    origin_y: float,
    step: float,
    top: float,
) -> None:
    """Set ``blocked`` ``(N, n)`` where points ``(n, 3)`` receive no light from lamps ``(N, 3)``.

    Elements that are already True are skipped. ``heights`` is the grid row by row, ``tiles`` the
    maximum of each tile, ``top`` the maximum of all heights.
    """
    count = len(points)
    for block in range(first, last):
        for k in range(len(lamps)):
            dx, dy, dz = lamps[k, 0], lamps[k, 1], lamps[k, 2]
            reach = 1.0 if near else math.inf
            for i in range(block * BLOCK, min((block + 1) * BLOCK, count)):
                if blocked[k, i]:
                    continue
                px, py, pz = points[i, 0], points[i, 1], points[i, 2]
                if near:
                    dx, dy, dz = lamps[k, 0] - px, lamps[k, 1] - py, lamps[k, 2] - pz
                if (len(spheres) and _sphere_between(px, py, pz, dx, dy, dz, reach, spheres)) or (
                    len(boxes) and _box_between(px, py, pz, dx, dy, dz, reach, boxes)
                ):
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
                        WALL * step,
                    )
