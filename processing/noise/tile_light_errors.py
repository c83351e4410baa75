"""Variances by the errors of lights and of the mean height, of several pixels at once, compiled.

The formulas are those of `light_table`, in loops over the pixels of a tile instead of over lights,
see `tile_reference`.
"""

from __future__ import annotations

import numba
import numpy as np

from processing.noise.tangents import tangent_change, tangent_trace
from processing.noise.tile_reference import BY_LIGHTS, HIGHER, LEAST, OF_ERRORS, TILE
from processing.stereo.pixel_algebra import ANY_ORDER, IN_PLACE
from rig.arrays import Float32, Float64, Intp

# Compiled in: processing/noise/tangents.py b051631d90b8
# Compiled in: processing/noise/tile_reference.py 32f37d79f34b
# Compiled in: processing/stereo/pixel_algebra.py f495374b06dc

# Parts of the state: sums of the matrix (6), of the changes by the height (3), and the point.
_CHANGES, _POINT = OF_ERRORS + 6, OF_ERRORS + 9


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=ANY_ORDER)
def _distant(i: int, table: Float32, row: Float32, state: Float32) -> None:
    """Write the variances of ``l . m`` by the errors of one distant light."""
    xx, xy, xz = table[8, i], table[9, i], table[10, i]
    yy, yz, zz, strength = table[11, i], table[12, i], table[13, i], table[14, i]
    zero, two = np.float32(0), np.float32(2)
    for k in range(TILE):
        mx, my, mz = state[k], state[TILE + k], state[2 * TILE + k]
        shading = row[k] * mx + row[TILE + k] * my + row[2 * TILE + k] * mz
        total = xx * mx * mx + yy * my * my + zz * mz * mz
        total += two * (xy * mx * my + (xz * mx + yz * my) * mz) + strength * shading * shading
        row[BY_LIGHTS * TILE + k] = total if shading > zero else zero


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=ANY_ORDER)
def _near(i: int, table: Float32, view: Float64, row: Float32, state: Float32) -> None:
    """Write the variances by the errors of one near light, and the changes by the height."""
    sx, sy, sz = table[0, i], table[1, i], table[2, i]
    ax, ay, az, mu = table[3, i], table[4, i], table[5, i], table[6, i]
    xx, xy, xz = table[8, i], table[9, i], table[10, i]
    yy, yz, zz = table[11, i], table[12, i], table[13, i]
    strength, turn = table[14, i], table[15, i] * mu * mu
    ox, oy, oz = table[17, i], table[18, i], table[19, i]
    dx, dy, dz = table[20, i], table[21, i], table[22, i]
    rise = np.float32(view[3])
    cx, cy, cz = np.float32(view[0]), np.float32(view[1]), np.float32(view[2])
    zero, one, two, three = np.float32(0), np.float32(1), np.float32(2), np.float32(3)
    for k in range(TILE):
        mx, my, mz = state[k], state[TILE + k], state[2 * TILE + k]
        lx, ly, lz = row[k], row[TILE + k], row[2 * TILE + k]
        shading = lx * mx + ly * my + lz * mz
        px, py = state[_POINT * TILE + k], state[(_POINT + 1) * TILE + k]
        pz = state[(_POINT + 2) * TILE + k]
        x, y, z = sx - px, sy - py, sz - pz
        per = one / np.sqrt(x * x + y * y + z * z)
        ux, uy, uz = x * per, y * per, z * per
        cosine = -(ux * ax + uy * ay + uz * az)
        inverse = one / cosine
        gain, relative, bend = (lx * ux + ly * uy + lz * uz) * per, shading * per, mu * inverse
        gx = gain * mx - relative * (three * ux + bend * (ax + cosine * ux))
        gy = gain * my - relative * (three * uy + bend * (ay + cosine * uy))
        gz = gain * mz - relative * (three * uz + bend * (az + cosine * uz))
        higher = rise * (gx * (px - cx) + gy * (py - cy) + gz * (pz - cz))
        gx += shading * ox
        gy += shading * oy
        gz += shading * oz
        total = xx * gx * gx + yy * gy * gy + zz * gz * gz
        total += two * (xy * gx * gy + (xz * gx + yz * gy) * gz)
        tx, ty, tz = dx - ux * inverse, dy - uy * inverse, dz - uz * inverse
        along = tx * ax + ty * ay + tz * az
        across = tx * tx + ty * ty + tz * tz - along * along
        total += (strength + turn * across) * shading * shading
        row[BY_LIGHTS * TILE + k] = total if shading > zero else zero
        row[HIGHER * TILE + k] = higher if shading > zero else zero


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=ANY_ORDER)
def _add_exponent(i: int, table: Float32, row: Float32, state: Float32) -> None:
    """Add the variances by the error of the exponent of one near light."""
    sx, sy, sz = table[0, i], table[1, i], table[2, i]
    ax, ay, az, per = table[3, i], table[4, i], table[5, i], np.float32(1) / table[7, i]
    variance = table[16, i]
    zero, one = np.float32(0), np.float32(1)
    third, fifth, seventh = one / np.float32(3), one / np.float32(5), one / np.float32(7)
    for k in range(TILE):
        shading = row[k] * state[k] + row[TILE + k] * state[TILE + k]
        shading += row[2 * TILE + k] * state[2 * TILE + k]
        x, y = sx - state[_POINT * TILE + k], sy - state[(_POINT + 1) * TILE + k]
        z = sz - state[(_POINT + 2) * TILE + k]
        ratio = -(x * ax + y * ay + z * az) * per / np.sqrt(x * x + y * y + z * z)
        # The logarithm is 8 times that of the eighth root, by the series of the inverse hyperbolic
        # tangent: loops with calls of a logarithm do not vectorise.
        root = np.sqrt(np.sqrt(np.sqrt(max(ratio, zero))))
        s = (root - one) / (root + one)
        s2 = s * s
        change = np.float32(16) * s * (one + s2 * (third + s2 * (fifth + s2 * seventh))) * shading
        row[BY_LIGHTS * TILE + k] += variance * change * change if shading > zero else zero


@numba.njit(**IN_PLACE, error_model="numpy")
def write_light_errors(
    first: int, count: int, near: bool, table: Float32, points: Float64, view: Float64,
    places: Intp, rows: Float32, state: Float32,
) -> None:  # fmt: skip
    """Write the variances by lights and the changes by height; see `reference_solutions`."""
    if near:
        for k in range(count):
            for c in range(3):
                state[(_POINT + c) * TILE + k] = points[places[first + k], c]
    for i in range(len(rows)):
        if near:
            _near(i, table, view, rows[i], state)
            if table[16, i] > 0:
                _add_exponent(i, table, rows[i], state)
        else:
            _distant(i, table, rows[i], state)


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=ANY_ORDER)
def _add_errors(row: Float32, state: Float32) -> None:
    zero, one = np.float32(0), np.float32(1)
    for k in range(TILE):
        x, y, z = row[k], row[TILE + k], row[2 * TILE + k]
        shading = x * state[k] + y * state[TILE + k] + z * state[2 * TILE + k]
        by_lights = row[BY_LIGHTS * TILE + k]
        variance = row[4 * TILE + k] + row[5 * TILE + k] * max(shading, zero)
        weight = one / (variance + state[LEAST * TILE + k] + by_lights)
        weight = weight if shading > zero else zero
        changed, w = weight * row[HIGHER * TILE + k], weight * weight * by_lights
        wx, wy, wz = w * x, w * y, w * z
        state[OF_ERRORS * TILE + k] += wx * x
        state[(OF_ERRORS + 1) * TILE + k] += wx * y
        state[(OF_ERRORS + 2) * TILE + k] += wx * z
        state[(OF_ERRORS + 3) * TILE + k] += wy * y
        state[(OF_ERRORS + 4) * TILE + k] += wy * z
        state[(OF_ERRORS + 5) * TILE + k] += wz * z
        state[_CHANGES * TILE + k] += changed * x
        state[(_CHANGES + 1) * TILE + k] += changed * y
        state[(_CHANGES + 2) * TILE + k] += changed * z


@numba.njit(**IN_PLACE, error_model="numpy")
def add_light_errors(rows: Float32, state: Float32) -> None:
    """Compute the sums of `write_parts`."""
    for i in range(len(rows)):
        _add_errors(rows[i], state)


@numba.njit(**IN_PLACE, error_model="numpy")
def write_parts(state: Float32, k: int, work: Float64, parts: Float32) -> None:
    """Split the variance of an ordinary pixel into noise and lights, and add that of the height.

    ``work`` and ``parts`` are what `ordinary` leaves.
    """
    inverse, inner, m = work[3:9], work[9:15], work[21:24]
    for s in range(6):
        inner[s] = state[(OF_ERRORS + s) * TILE + k]
    length2, total = m[0] * m[0] + m[1] * m[1] + m[2] * m[2], parts[0]
    parts[1] = min(tangent_trace(inverse, m, inner) / length2, total)
    parts[0] = total - parts[1]
    b0, b1 = state[_CHANGES * TILE + k], state[(_CHANGES + 1) * TILE + k]
    b2 = state[(_CHANGES + 2) * TILE + k]
    parts[2] = tangent_change(inverse, m, b0, b1, b2) / length2
