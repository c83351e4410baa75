"""The Cramer-Rao bound: the smallest angular error of an unbiased estimate of a normal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np

from acquisition import DataError, Lights, NoiseModel
from rig import in_threads, short_repr
from rig.arrays import Bool, Float32, Float64, Floating, Integer
from rig.kernels import PART
from simulator.rendering.shade import lamp_table

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

# Determinants below this share of the product of the diagonal mean that the lights are coplanar.
_SINGULAR = 1e-10


@dataclass(frozen=True, eq=False)
class Measurement:
    """How a camera measures the light that arrives at its pixels.

    Parameters
    ----------
    noise
        Model of the sensor.
    photons_per_us
        Photons per microsecond of a white surface under irradiance 1, one number or ``(H, W)``,
        for example with vignetting.
    exposures_us
        Exposure times of the images of each light, microseconds above 0: one per bracket, repeated
        images repeated.
    background_per_us
        Photons per microsecond from the room, one number or ``(H, W)``.
    channel
        ``(H, W)`` channel of each pixel of a mosaic, 0, 1 or 2. None for a monochrome camera, which
        sees the mean over the three channels of intensity times albedo.
    gain_db
        Analogue gain, decibels.
    """

    noise: NoiseModel
    photons_per_us: float | Floating
    exposures_us: Sequence[float]
    background_per_us: float | Floating = 0.0
    channel: Integer | None = None
    gain_db: float = 0.0

    __repr__ = short_repr


def cramer_rao_deg(
    normals: Floating,
    albedo: Floating,
    lights: Lights,
    measurement: Measurement,
    *,
    points_mm: Floating | None = None,
    shadows: Bool | None = None,
) -> Float32:
    r"""Return the Cramer-Rao bound of the angular error of normals under a measurement.

    The model is Lambertian: light i with vector ``l_i`` (direction times irradiance) yields
    ``s_i = A l_i . m`` electrons with ``m = albedo * normal`` and A electrons per unit. If v_i is
    the variance of a sample (shot noise of all its electrons, read noise, quantisation), the Fisher
    information on m is ``F = sum_i A^2 l_i l_i^T / v_i``. An unknown albedo moves m only along the
    normal n, so the error of the direction is the inverse of F projected on the tangent plane::

        E[angle^2] >= (tr(F^-1) - n^T F^-1 n) / albedo^2     [rad^2, small angles]

    (Kay, Fundamentals of Statistical Signal Processing I, 1993, chapter 3; variances as in EMVA
    1288.) Lights, albedo scale and black level are assumed to be known and fixed patterns to be
    corrected; a relative response that is common to all images of a pixel is part of its albedo.
    Samples that are in shadow or saturated contribute no information. The dependence of the
    variance on the signal is not counted as information: it matters only below about ten electrons.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` unit vectors, 0 outside the mask.
    albedo
        ``(H, W)``, or ``(H, W, 3)`` for coloured surfaces.
    lights
        N near or distant lights.
    measurement
        How the camera measures them; its maps have the size of the normals.
    points_mm
        ``(H, W, 3)`` points of the surface; needed for near lights.
    shadows
        ``(N, H, W)`` True where a light does not reach the point. Surfaces that face away from a
        light need not be marked.

    Returns
    -------
    Values
        ``(H, W)`` root mean square angle in degrees: NaN outside the mask, infinite where fewer
        than three independent lights are measured.

    Raises
    ------
    DataError
        If shapes differ, an exposure time is not positive, or near lights are given without points.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Lights
    >>> from simulator import bench_sensor
    >>> from simulator.rendering import Measurement, cramer_rao_deg
    >>> lights = Lights(directions=[[1, 0, 1], [0, 1, 1], [-1, -1, 1]])
    >>> measured = Measurement(bench_sensor(), photons_per_us=1.0, exposures_us=[5000.0] * 3)
    >>> normals = np.tile([0.0, 0.0, 1.0], (1, 1, 1))
    >>> cramer_rao_deg(normals, np.full((1, 1), 0.5), lights, measured).round(1)
    array([[0.9]], dtype=float32)
    """
    shape, exposures_us = normals.shape[:2], measurement.exposures_us
    wanted = {
        "normals": (normals, (*shape, 3)),
        "albedo": (albedo, (*shape, 3) if albedo.ndim == 3 else shape),
        "points_mm": (points_mm, (*shape, 3)),
        "shadows": (shadows, (len(lights), *shape)),
        "channel": (measurement.channel, shape),
    }
    for name, (array, size) in wanted.items():
        if array is not None and array.shape != size:
            raise DataError(f"Cramer-Rao bound: {name} has shape {array.shape}, expected {size}")
    if lights.near and points_mm is None:
        raise DataError("Cramer-Rao bound: near lights require points_mm")
    if not exposures_us or not all(0 < value < math.inf for value in exposures_us):
        raise DataError(
            f"Cramer-Rao bound: exposure times {list(exposures_us)} us must be positive"
        )
    share, seen = _colours(albedo, measurement.channel)
    noise = measurement.noise
    scale = noise.quantum_efficiency
    electrons_per_dn = noise.electrons_per_dn / 10.0 ** (measurement.gain_db / 20.0)
    white_e = (noise.converter_end_dn - noise.black_level_dn) * electrons_per_dn
    out = np.full(shape, np.nan, np.float32)
    in_threads(
        _bound,
        len(out),
        np.ascontiguousarray(normals, np.float32),
        np.ascontiguousarray(seen, np.float32),
        np.ascontiguousarray(np.zeros((1, 1, 3)) if points_mm is None else points_mm, np.float32),
        np.ascontiguousarray(np.zeros((0, 0, 0)) if shadows is None else shadows, np.bool_),
        np.ascontiguousarray(share, np.float32),
        _light_table(lights),
        np.ascontiguousarray(lights.intensities, np.float64),
        lights.near,
        _plane("photons_per_us", measurement.photons_per_us, shape) * scale,
        _plane("background_per_us", measurement.background_per_us, shape) * scale,
        np.array(exposures_us, np.float64),
        noise.dark_current_e_per_s / 1e6,
        noise.read_noise_e**2 + electrons_per_dn**2 / 12,
        white_e if noise.full_well_e is None else min(white_e, noise.full_well_e),
        out,
    )
    return out


def _colours(albedo: Floating, channel: Integer | None) -> tuple[Floating, Floating]:
    """Return the weights of the intensities, ``(H, W, 3)`` with sum 1, and the albedo of pixels.

    A pixel sees its albedo times the weighted mean of the intensities.
    """
    colour = albedo if albedo.ndim == 3 else np.repeat(albedo[..., None], 3, axis=2)
    if channel is not None:
        share = (channel[..., None] == np.arange(3)).astype(np.float64)
        return share, (share * colour).sum(axis=2)
    total = colour.sum(axis=2, keepdims=True)
    return np.where(total > 0, colour, 1.0) / np.where(total > 0, total, 3.0), total[..., 0] / 3


def _plane(name: str, value: float | Floating, shape: tuple[int, ...]) -> Float64:
    array = np.asarray(value, np.float64)
    if array.ndim and array.shape != shape:
        raise DataError(f"Cramer-Rao bound: {name} has shape {array.shape}, expected {shape}")
    return np.full(shape, array)


def _light_table(lights: Lights) -> Float64:
    """Return `lamp_table` of lights that shine on the origin."""
    if lights.positions_mm is not None:
        place = lights.positions_mm
        cosine = -(place * np.asarray(lights.axes)).sum(axis=1)
        cosine /= np.sqrt((place**2).sum(axis=1))
        if np.any(cosine <= 0):
            dark = lights.ids[int(np.argmin(cosine))]
            raise DataError(f"Cramer-Rao bound: light {dark} points away from the origin")
    return lamp_table(lights)


@numba.njit(nogil=True, cache=True)
def _bound(
    first: int,
    last: int,
    normals: Float32,
    albedo: Float32,
    points: Float32,
    shadows: Bool,
    share: Float32,
    lights: Float64,
    intensities: Float64,
    near: bool,
    rate: Float64,
    background: Float64,
    exposures: Float64,
    dark_e_per_us: float,
    floor_variance: float,
    white_e: float,
    out: Float32,
) -> None:
    width = albedo.shape[1]
    for row in range(first, last):
        for column in range(width):
            nx = np.float64(normals[row, column, 0])
            ny = np.float64(normals[row, column, 1])
            nz = np.float64(normals[row, column, 2])
            if nx * nx + ny * ny + nz * nz == 0.0:
                continue
            rho = np.float64(albedo[row, column])
            red, green = share[row, column, 0], share[row, column, 1]
            blue = share[row, column, 2]
            a, b, c, d, e, f = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(len(lights)):
                if shadows.size and shadows[k, row, column]:
                    continue
                x, y, z = lights[k, 0], lights[k, 1], lights[k, 2]
                gain = red * intensities[k, 0] + green * intensities[k, 1]
                gain += blue * intensities[k, 2]
                if near:
                    x -= points[row, column, 0]
                    y -= points[row, column, 1]
                    z -= points[row, column, 2]
                    ahead = -(x * lights[k, 3] + y * lights[k, 4] + z * lights[k, 5])
                    if ahead <= 0.0:
                        continue
                    r = math.sqrt(x * x + y * y + z * z)
                    # The factor of l in l / r times the irradiance.
                    gain *= lights[k, 7] * (ahead / r) ** lights[k, 6] / (r * r * r)
                facing = nx * x + ny * y + nz * z
                if facing <= 0.0:
                    continue
                weight = 0.0
                for t in exposures:
                    slope = rate[row, column] * t * gain
                    mean = slope * rho * facing + (background[row, column] + dark_e_per_us) * t
                    if mean < white_e:
                        weight += slope * slope / (mean + floor_variance)
                a += weight * x * x
                b += weight * x * y
                c += weight * x * z
                d += weight * y * y
                e += weight * y * z
                f += weight * z * z
            out[row, column] = _angle_deg(a, b, c, d, e, f, nx, ny, nz, rho)


@numba.njit(**PART)
def _angle_deg(
    a: float,
    b: float,
    c: float,
    d: float,
    e: float,
    f: float,
    nx: float,
    ny: float,
    nz: float,
    rho: float,
) -> float:
    """Return the bound from the information [a b c; b d e; c e f] on albedo times normal."""
    # Cofactors; the inverse is their matrix divided by the determinant.
    aa, bb, cc = d * f - e * e, c * e - b * f, b * e - c * d
    dd, ee, ff = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * aa + b * bb + c * cc
    if rho <= 0.0 or determinant <= _SINGULAR * a * d * f or a * d * f == 0.0:
        return np.inf
    along = nx * (aa * nx + bb * ny + cc * nz)
    along += ny * (bb * nx + dd * ny + ee * nz)
    along += nz * (cc * nx + ee * ny + ff * nz)
    squared = (aa + dd + ff - along) / (determinant * rho * rho)
    return math.degrees(math.sqrt(max(squared, 0.0)))
