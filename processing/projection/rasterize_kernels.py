"""Compiled rendering of triangles: vertex normals, bands of rows, z-buffer and shading.

`draw` finds the visible face of every pixel, with corners that are snapped to a grid. `shade` then
intersects that face with the exact line of sight of the pixel. The results do not depend on the
number of threads.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from rig.arrays import Bool, Float32, Float64, Int16, Int32, Int64
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

# Number of rows in a band, which one thread draws alone.
BAND_ROWS = 32
# Corners are rounded to 1 / 2^14 pixel. Up to 4096 pixels from a pixel, products of two distances
# then fit into 53 bits, so the test on which side of an edge the pixel is is exact.
_SNAP = 16384.0
# Number of parts in which the faces are counted; it is fixed, so the order of the faces is, too.
_PARTS = 64
# A face has no direction if twice its area, relative to the square of its longest edge, is below
# this.
_THIN = 1e-12
# Squared cosine of 30 degrees.
_BLUNT2 = 0.75
# A value below any nonzero cross product of snapped corners.
_NEXT_TO_ZERO = 1e-300


@numba.njit(cache=True)
def turned(points: Float64, matrix: Float64) -> Float64:
    """Return ``(N, 3)`` points times a 3 x 3 matrix, ten times as fast as BLAS."""
    out = np.zeros(points.shape, np.float64)
    for v in range(len(points)):
        x, y, z = points[v, 0], points[v, 1], points[v, 2]
        for axis in range(3):
            out[v, axis] = matrix[axis, 0] * x + matrix[axis, 1] * y + matrix[axis, 2] * z
    return out


@numba.njit(cache=True)
def bounds(points: Float64) -> tuple[Float64, Float64]:
    """Return the lowest and the highest x, y, z of ``(N, 3)`` points."""
    low, high = points[0].copy(), points[0].copy()
    for v in range(len(points)):
        for axis in range(3):
            low[axis] = min(low[axis], points[v, axis])
            high[axis] = max(high[axis], points[v, axis])
    return low, high


@numba.njit(cache=True)
def vertex_normals(
    vertices: Float64, faces: Int32, corners: Int32, count: int
) -> tuple[Float32, int]:
    """Return area-weighted unit normals ``(count, 3)`` and the number of faces without area.

    ``corners`` ``(F, 3)`` are the numbers of the normals at the corners of the faces: `faces`
    itself if all faces at a vertex share its normal. The normal is 0 for a number without faces,
    and if the normals of its faces cancel out.
    """
    total = np.zeros((count, 3), np.float64)
    thin = 0
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        nx, ny, nz = _cross(vertices, a, b, c)
        if nx * nx + ny * ny + nz * nz <= (_THIN * _longest2(vertices, a, b, c)) ** 2:
            thin += 1
            continue
        for k in range(3):
            v = corners[f, k]
            total[v, 0] += nx
            total[v, 1] += ny
            total[v, 2] += nz
    normals = np.zeros((count, 3), np.float32)
    for v in range(count):
        length = math.sqrt(total[v, 0] ** 2 + total[v, 1] ** 2 + total[v, 2] ** 2)
        if length > 0:
            for axis in range(3):
                normals[v, axis] = total[v, axis] / length
    return normals, thin


@numba.njit(cache=True)
def sound_faces(vertices: Float64, faces: Int32) -> Bool:
    """Return the mask of the faces that have an area."""
    sound = np.zeros(len(faces), np.bool_)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        nx, ny, nz = _cross(vertices, a, b, c)
        longest2 = _longest2(vertices, a, b, c)
        sound[f] = nx * nx + ny * ny + nz * nz > (_THIN * longest2) ** 2
    return sound


@numba.njit(**PART)
def _cross(vertices: Float64, a: int, b: int, c: int) -> tuple[float, float, float]:
    ux, uy, uz = (
        vertices[b, 0] - vertices[a, 0],
        vertices[b, 1] - vertices[a, 1],
        vertices[b, 2] - vertices[a, 2],
    )
    vx, vy, vz = (
        vertices[c, 0] - vertices[a, 0],
        vertices[c, 1] - vertices[a, 1],
        vertices[c, 2] - vertices[a, 2],
    )
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@numba.njit(**PART)
def _longest2(vertices: Float64, a: int, b: int, c: int) -> float:
    longest = 0.0
    for p, q in ((a, b), (b, c), (c, a)):
        length2 = 0.0
        for axis in range(3):
            length2 += (vertices[p, axis] - vertices[q, axis]) ** 2
        longest = max(longest, length2)
    return longest


@numba.njit(cache=True)
def snap(pixels: Float64, nearness: Float64) -> Float32:
    """Return ``(V, 3)``: x and y in pixels on the grid of the z-buffer, and the nearness."""
    screen = np.zeros((len(pixels), 3), np.float32)
    for v in range(len(pixels)):
        screen[v, 0] = np.rint(pixels[v, 0] * _SNAP) / _SNAP
        screen[v, 1] = np.rint(pixels[v, 1] * _SNAP) / _SNAP
        screen[v, 2] = nearness[v]
    return screen


@numba.njit(cache=True)
def face_bands(screen: Float32, faces: Int32, rows: int, columns: int) -> tuple[Int16, Int16]:
    """Return the first and last band of rows that each face may touch; (1, 0) for no band."""
    first, last = np.ones(len(faces), np.int16), np.zeros(len(faces), np.int16)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        left = math.ceil(max(min(screen[a, 0], screen[b, 0], screen[c, 0]), 0.0))
        right = math.floor(min(max(screen[a, 0], screen[b, 0], screen[c, 0]), columns - 1.0))
        top = math.ceil(max(min(screen[a, 1], screen[b, 1], screen[c, 1]), 0.0))
        bottom = math.floor(min(max(screen[a, 1], screen[b, 1], screen[c, 1]), rows - 1.0))
        if left <= right and top <= bottom:
            first[f], last[f] = top // BAND_ROWS, bottom // BAND_ROWS
    return first, last


@numba.njit(cache=True)
def sort_into_bands(first: Int16, last: Int16, bands: int) -> tuple[Int32, Int64]:
    """Return the indices of the items in each band, ascending, and the start of each band."""
    begin = np.zeros(bands + 1, np.int64)
    for i in range(len(first)):
        for band in range(first[i], last[i] + 1):
            begin[band + 1] += 1
    place = np.zeros(bands, np.int64)
    for band in range(bands):
        place[band] = begin[band]
        begin[band + 1] += begin[band]
    members = np.zeros(begin[bands], np.int32)
    for i in range(len(first)):
        for band in range(first[i], last[i] + 1):
            members[place[band]] = i
            place[band] += 1
    return members, begin


@numba.njit(**PART)
def _least(dx: float, dy: float) -> float:
    """Return the smallest edge function of a covered pixel; top and left edges are covered."""
    return 0.0 if dy < 0 or (dy == 0 and dx > 0) else _NEXT_TO_ZERO


@numba.njit(nogil=True, cache=True, error_model="numpy")
def draw(
    first_band: int,
    last_band: int,
    screen: Float32,
    faces: Int32,
    members: Int32,
    begin: Int64,
    nearest: Float32,
    seen: Int32,
) -> None:
    """Find the nearest face at each pixel's centre; of equally near faces, the first.

    ``nearest`` starts at -inf and ``seen`` at -1; `members` and `begin` are from `sort_into_bands`.
    """
    rows, columns = nearest.shape
    for band in range(first_band, last_band):
        for m in range(begin[band], begin[band + 1]):
            f = members[m]
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            ax, ay = float(screen[a, 0]), float(screen[a, 1])
            bx, by = float(screen[b, 0]), float(screen[b, 1])
            cx, cy = float(screen[c, 0]), float(screen[c, 1])
            area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
            if area == 0:
                continue
            if area < 0:
                bx, by, cx, cy = cx, cy, bx, by
                b, c = c, b
            az, bz, cz = float(screen[a, 2]), float(screen[b, 2]), float(screen[c, 2])
            least_a = _least(cx - bx, cy - by)
            least_b = _least(ax - cx, ay - cy)
            least_c = _least(bx - ax, by - ay)
            left = math.ceil(max(min(ax, bx, cx), 0.0))
            right = math.floor(min(max(ax, bx, cx), columns - 1.0))
            top = math.ceil(max(min(ay, by, cy), band * BAND_ROWS))
            bottom = math.floor(min(max(ay, by, cy), rows - 1, (band + 1) * BAND_ROWS - 1))
            for r in range(top, bottom + 1):
                a_y, b_y, c_y = ay - r, by - r, cy - r
                for column in range(left, right + 1):
                    a_x, b_x, c_x = ax - column, bx - column, cx - column
                    # Swapping the ends of an edge changes only the sign, exactly.
                    edge_a = b_x * c_y - b_y * c_x
                    edge_b = c_x * a_y - c_y * a_x
                    edge_c = a_x * b_y - a_y * b_x
                    if edge_a >= least_a and edge_b >= least_b and edge_c >= least_c:
                        total = edge_a + edge_b + edge_c
                        near = np.float32((edge_a * az + edge_b * bz + edge_c * cz) / total)
                        if near > nearest[r, column]:
                            nearest[r, column] = near
                            seen[r, column] = f


@numba.njit(nogil=True, cache=True, error_model="numpy")
def shade(
    first_row: int,
    last_row: int,
    seen: Int32,
    vertices: Float64,
    faces: Int32,
    vertex_normal: Float32,
    corners: Int32,
    smooth: bool,
    x: Float64,
    y: Float64,
    rays: Float64,
    eye_z: float,
    normals: Float32,
    height: Float32,
    back: Int32,
    blunt: Int32,
) -> None:
    """Fill in normals and heights of visible faces, and two counts for each row.

    They are the pixels that show back sides, and those whose blended normal differs by more than
    30 degrees from that of their face. ``corners`` are those of `vertex_normals`.

    The line of sight of a pixel is ``(x[c] + s rays[r, c, 0], y[r] + s rays[r, c, 1], eye_z - s)``;
    `rays` of shape ``(1, 1, 2)`` applies to all pixels.
    """
    columns = seen.shape[1]
    bent = rays.shape[0] > 1
    for r in range(first_row, last_row):
        for column in range(columns):
            f = seen[r, column]
            if f < 0:
                continue
            ray_x = rays[r, column, 0] if bent else rays[0, 0, 0]
            ray_y = rays[r, column, 1] if bent else rays[0, 0, 1]
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            # Shear the coordinates so that the line of sight is the z axis.
            sa, sb, sc = eye_z - vertices[a, 2], eye_z - vertices[b, 2], eye_z - vertices[c, 2]
            ax, ay = vertices[a, 0] - x[column] - sa * ray_x, vertices[a, 1] - y[r] - sa * ray_y
            bx, by = vertices[b, 0] - x[column] - sb * ray_x, vertices[b, 1] - y[r] - sb * ray_y
            cx, cy = vertices[c, 0] - x[column] - sc * ray_x, vertices[c, 1] - y[r] - sc * ray_y
            wa, wb, wc = bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx
            side = 1.0 if wa + wb + wc > 0 else -1.0
            back[r] += side < 0
            # The snapped face may extend slightly beyond the true face.
            wa, wb, wc = max(side * wa, 0.0), max(side * wb, 0.0), max(side * wc, 0.0)
            total = wa + wb + wc
            if total == 0:
                wa = wb = wc = 1.0
                total = 3.0
            wa, wb, wc = wa / total, wb / total, wc / total
            height[r, column] = wa * vertices[a, 2] + wb * vertices[b, 2] + wc * vertices[c, 2]
            nx = ny = nz = 0.0
            if smooth:
                i, j, k = corners[f, 0], corners[f, 1], corners[f, 2]
                nx = wa * vertex_normal[i, 0] + wb * vertex_normal[j, 0] + wc * vertex_normal[k, 0]
                ny = wa * vertex_normal[i, 1] + wb * vertex_normal[j, 1] + wc * vertex_normal[k, 1]
                nz = wa * vertex_normal[i, 2] + wb * vertex_normal[j, 2] + wc * vertex_normal[k, 2]
                fx, fy, fz = _cross(vertices, a, b, c)
                along = nx * fx + ny * fy + nz * fz
                size2 = (nx * nx + ny * ny + nz * nz) * (fx * fx + fy * fy + fz * fz)
                blunt[r] += along < 0 or along * along < _BLUNT2 * size2
            # Flat shading, or smooth normals that cancel out.
            if nx * nx + ny * ny + nz * nz < 1e-12:
                nx, ny, nz = _cross(vertices, a, b, c)
            scale = side / math.sqrt(nx * nx + ny * ny + nz * nz)
            normals[r, column, 0] = scale * nx
            normals[r, column, 1] = scale * ny
            normals[r, column, 2] = scale * nz
