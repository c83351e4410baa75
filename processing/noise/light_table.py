"""The errors of lights as a table, and the variance that they add to a sample."""

from __future__ import annotations

import math

import numba
import numpy as np

from acquisition import Lights
from acquisition.values import tangent_basis
from processing.stereo.pixel_algebra import ANY_ORDER, IN_PLACE
from rig.arrays import Float32, Float64

# Compiled in: processing/stereo/pixel_algebra.py f495374b06dc

# Rows: position, axis, mu, cosine c0 at the origin, covariance (xx, xy, xz, yy, yz, zz), relative
# variance of the intensity, variance of the axis (rad^2) and of mu, derivative of the logarithm of
# r0^2 / c0^mu by the position, direction from the origin divided by c0.
_ROWS = 23
ERRORS = slice(8, 17)


def light_table(lights: Lights) -> Float32:
    """Return ``(23, N)`` geometry and errors of lights; values that are not known are 0."""
    table = np.zeros((len(lights), _ROWS))
    errors = lights.errors
    if lights.positions_mm is not None:
        positions, axes, mu = lights.positions_mm, np.asarray(lights.axes), np.asarray(lights.mu)
        r0 = np.linalg.norm(positions, axis=1)
        u0 = positions / r0[:, None]
        c0 = -np.sum(u0 * axes, axis=1)
        table[:, 0:3], table[:, 3:6], table[:, 6] = positions, axes, mu
        table[:, 7] = c0
        of_cosine = -(axes + c0[:, None] * u0) / r0[:, None]
        table[:, 17:20] = 2 * u0 / r0[:, None] - (mu / c0)[:, None] * of_cosine
        table[:, 20:23] = u0 / c0[:, None]
    if errors is None:
        return _rows(table)
    if errors.covariances is not None:
        covariances = np.nan_to_num(errors.covariances)
        if not lights.near:
            basis = tangent_basis(lights.unit_directions)
            covariances = basis.transpose(0, 2, 1) @ covariances @ basis
        table[:, 8:14] = covariances[:, *np.triu_indices(3)]
    if errors.intensity_std is not None:
        strength = np.asarray(lights.intensities).mean(axis=1)
        table[:, 14] = np.nan_to_num(errors.intensity_std.mean(axis=1) / strength) ** 2
    if errors.axis_std_deg is not None:
        table[:, 15] = np.nan_to_num(np.radians(errors.axis_std_deg)) ** 2
    if errors.mu_std is not None:
        table[:, 16] = np.nan_to_num(errors.mu_std) ** 2
    return _rows(table)


def _rows(table: Float64) -> Float32:
    return np.ascontiguousarray(table.T, np.float32)


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=ANY_ORDER)
def distant_variances(table: Float32, vectors: Float32, m: Float64, variance: Float32) -> None:
    """Write the variances of ``l . m`` by the errors of distant lights; 0 in attached shadow."""
    mx, my, mz = np.float32(m[0]), np.float32(m[1]), np.float32(m[2])
    zero, two = np.float32(0), np.float32(2)
    for i in range(len(variance)):
        shading = vectors[0, i] * mx + vectors[1, i] * my + vectors[2, i] * mz
        total = table[8, i] * mx * mx + table[11, i] * my * my + table[13, i] * mz * mz
        total += two * table[9, i] * mx * my
        total += two * (table[10, i] * mx + table[12, i] * my) * mz
        total += table[14, i] * shading * shading
        variance[i] = total if shading > zero else zero


@numba.njit(**IN_PLACE, error_model="numpy", fastmath=ANY_ORDER)
def near_variances(
    table: Float32, vectors: Float32, point: Float64, view: Float64, m: Float64, variance: Float32,
    higher: Float32,
) -> None:  # fmt: skip
    """Write the variances of ``l . m`` by the errors of near lights, and its changes by the height.

    Parameters
    ----------
    table, vectors
        `light_table` of N lights, and their vectors ``(3, N)`` at the point.
    point, view
        Surface point; centre of the camera and the share of its distance by which the point moves
        toward it.
    m
        Scaled normal.
    variance, higher
        ``(N,)``, receive the result; 0 in attached shadow.
    """
    mx, my, mz = np.float32(m[0]), np.float32(m[1]), np.float32(m[2])
    px, py, pz = np.float32(point[0]), np.float32(point[1]), np.float32(point[2])
    rise = np.float32(view[3])
    rx = (px - np.float32(view[0])) * rise
    ry = (py - np.float32(view[1])) * rise
    rz = (pz - np.float32(view[2])) * rise
    zero, one, two, three = np.float32(0), np.float32(1), np.float32(2), np.float32(3)
    for i in range(len(variance)):
        lx, ly, lz = vectors[0, i], vectors[1, i], vectors[2, i]
        shading = lx * mx + ly * my + lz * mz
        x, y, z = table[0, i] - px, table[1, i] - py, table[2, i] - pz
        per = one / np.sqrt(x * x + y * y + z * z)
        ux, uy, uz = x * per, y * per, z * per
        ax, ay, az, mu = table[3, i], table[4, i], table[5, i], table[6, i]
        cosine = -(ux * ax + uy * ay + uz * az)
        inverse = one / cosine
        gain, relative, bend = (lx * ux + ly * uy + lz * uz) * per, shading * per, mu * inverse
        # Derivatives by the position of the light, as seen from the point.
        gx = gain * mx - relative * (three * ux + bend * (ax + cosine * ux))
        gy = gain * my - relative * (three * uy + bend * (ay + cosine * uy))
        gz = gain * mz - relative * (three * uz + bend * (az + cosine * uz))
        higher[i] = gx * rx + gy * ry + gz * rz if shading > zero else zero
        # The irradiance at the origin stays the same if the light moves.
        gx += shading * table[17, i]
        gy += shading * table[18, i]
        gz += shading * table[19, i]
        total = table[8, i] * gx * gx + table[11, i] * gy * gy + table[13, i] * gz * gz
        total += two * table[9, i] * gx * gy
        total += two * (table[10, i] * gx + table[12, i] * gy) * gz
        tx = table[20, i] - ux * inverse
        ty = table[21, i] - uy * inverse
        tz = table[22, i] - uz * inverse
        along = tx * ax + ty * ay + tz * az
        across = tx * tx + ty * ty + tz * tz - along * along
        total += (table[14, i] + table[15, i] * mu * mu * across) * shading * shading
        variance[i] = total if shading > zero else zero
    for i in range(len(variance)):
        shading = vectors[0, i] * mx + vectors[1, i] * my + vectors[2, i] * mz
        if table[16, i] > zero and shading > zero:
            x, y, z = table[0, i] - px, table[1, i] - py, table[2, i] - pz
            along = -(x * table[3, i] + y * table[4, i] + z * table[5, i])
            ratio = along / (table[7, i] * math.sqrt(x * x + y * y + z * z))
            variance[i] += table[16, i] * np.float32(shading * math.log(ratio)) ** 2
