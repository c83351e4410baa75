"""The errors of lights as a table, and the variance that they add to a sample."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from acquisition import Lights, tangent_basis

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]

# Columns: position, axis, mu, r0^2 / c0^mu, covariance (xx, xy, xz, yy, yz, zz), relative variance
# of the intensity, variance of the axis (rad^2) and of mu, cosine c0 at the origin, derivative of
# the logarithm of column 7 by the position, direction from the origin.
_COLUMNS = 24


def light_table(lights: Lights) -> Double:
    """Return ``(N, 24)`` geometry and errors of lights; values that are not known are 0."""
    count = len(lights)
    table = np.zeros((count, _COLUMNS))
    errors = lights.errors
    if lights.positions_mm is not None:
        positions, axes, mu = lights.positions_mm, np.asarray(lights.axes), np.asarray(lights.mu)
        r0 = np.linalg.norm(positions, axis=1)
        u0 = positions / r0[:, None]
        c0 = -np.sum(u0 * axes, axis=1)
        table[:, 0:3], table[:, 3:6], table[:, 6] = positions, axes, mu
        table[:, 7] = r0**2 / c0**mu
        table[:, 17] = c0
        of_cosine = -(axes + c0[:, None] * u0) / r0[:, None]
        table[:, 18:21] = 2 * u0 / r0[:, None] - (mu / c0)[:, None] * of_cosine
        table[:, 21:24] = u0
    if errors is None:
        return table
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
    return table


@numba.njit(cache=True, error_model="numpy")
def distant_variance(light: Double, m: Double, shading: float) -> float:
    """Return the variance of ``l . m`` by the errors of a distant light."""
    variance = light[8] * m[0] * m[0] + light[11] * m[1] * m[1] + light[13] * m[2] * m[2]
    variance += 2 * (light[9] * m[0] * m[1] + light[10] * m[0] * m[2] + light[12] * m[1] * m[2])
    return float(variance + light[14] * shading * shading)


@numba.njit(cache=True, error_model="numpy")
def near_variance(
    light: Double, point: Double, view: Double, m: Double, shading: float, strength: float
) -> tuple[float, float]:
    """Return the variance of ``l . m`` by the errors of a near light, and its change by the height.

    Parameters
    ----------
    light
        Row of a `light_table`.
    point, view
        Surface point; centre of the camera and the share of its distance by which the point moves
        toward it.
    m
        Scaled normal.
    shading, strength
        ``l . m`` and the length of l.
    """
    x, y, z = light[0] - point[0], light[1] - point[1], light[2] - point[2]
    per = 1.0 / math.sqrt(x * x + y * y + z * z)
    ux, uy, uz = x * per, y * per, z * per
    ax, ay, az, mu = light[3], light[4], light[5], light[6]
    cosine = -(ux * ax + uy * ay + uz * az)
    gain, relative = strength * per, shading * per
    bend = mu / cosine
    # Derivatives by the position of the light, as seen from the point.
    gx = gain * m[0] - relative * (3 * ux + bend * (ax + cosine * ux))
    gy = gain * m[1] - relative * (3 * uy + bend * (ay + cosine * uy))
    gz = gain * m[2] - relative * (3 * uz + bend * (az + cosine * uz))
    higher = gx * (point[0] - view[0]) + gy * (point[1] - view[1]) + gz * (point[2] - view[2])
    higher *= view[3]
    # The irradiance at the origin stays the same if the light moves.
    gx += shading * light[18]
    gy += shading * light[19]
    gz += shading * light[20]
    variance = light[8] * gx * gx + light[11] * gy * gy + light[13] * gz * gz
    variance += 2 * (light[9] * gx * gy + light[10] * gx * gz + light[12] * gy * gz)
    variance += light[14] * shading * shading
    if light[15] > 0.0:
        c0 = light[17]
        tx = light[21] / c0 - ux / cosine
        ty = light[22] / c0 - uy / cosine
        tz = light[23] / c0 - uz / cosine
        along = tx * ax + ty * ay + tz * az
        across = tx * tx + ty * ty + tz * tz - along * along
        variance += light[15] * (shading * mu) ** 2 * across
    if light[16] > 0.0:
        variance += light[16] * (shading * math.log(cosine / light[17])) ** 2
    return float(variance), float(higher)


@numba.njit(cache=True, error_model="numpy")
def _write_variances(
    vectors: Float, m: Double, table: Double, near: bool, point: Double, out: Double
) -> None:
    nowhere = np.zeros(4)
    for i in range(len(out)):
        x, y, z = float(vectors[0, i]), float(vectors[1, i]), float(vectors[2, i])
        shading = x * m[0] + y * m[1] + z * m[2]
        if shading > 0.0 and near:
            strength = math.sqrt(x * x + y * y + z * z)
            variance, _ = near_variance(table[i], point, nowhere, m, shading, strength)
            out[i] = variance
        elif shading > 0.0:
            out[i] = distant_variance(table[i], m, shading)


@numba.njit(parallel=True, cache=True, error_model="numpy")
def light_variances(
    vectors: Float, solutions: Double, table: Double, near: bool, points: Double, out: Double
) -> None:
    """Write the variances ``(P, N)`` of the shading of pixels by the errors of the lights."""
    for p in numba.prange(len(out)):
        of_pixel = vectors[p] if len(vectors) > 1 else vectors[0]
        point = points[p] if near else points[0]
        _write_variances(of_pixel, solutions[p], table, near, point, out[p])
