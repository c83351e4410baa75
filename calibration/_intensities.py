"""How strong near lights are, and how they spread, from a matte plane."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from acquisition import DataError, Lights
from calibration._errors import EstimateError

Array = npt.NDArray[np.float64]

_PIXELS = 20_000
_ROUNDS = 30
# A pixel whose darkest sample is below this share of the typical one is in some light's shadow.
_DARK = 0.1
_FEWEST = 100
_POOR_FIT = 0.03


@dataclass(frozen=True)
class IntensityCalibration:
    """Lights with their intensities, and the evidence.

    Parameters
    ----------
    lights
        The lights with relative intensities (mean 1) and the common `mu`.
    mu
        Exponent of the radiation pattern, the same for all lights, at least 0.
    residual
        Robust relative scatter of the plane about the model, 0.01 is 1 %.
    pixels
        How many pixels were used.
    warnings
        What deserves a look, one line each.
    """

    lights: Lights
    mu: float
    residual: float
    pixels: int
    warnings: tuple[str, ...]


def calibrate_intensities(
    values: npt.NDArray[np.float32],
    lights: Lights,
    points_mm: npt.ArrayLike,
    mask: npt.NDArray[np.bool_],
) -> IntensityCalibration:
    """Estimate relative intensities and one `mu` from images of a matte plane at z = 0.

    Every sample obeys ``log value = log intensity(light) + log albedo(pixel) + mu * log cosine +
    known geometry`` (the LED model of Queau et al., 2018): additive in the logarithm, and solved by
    alternating weighted means with Cauchy weights. The plane may be of any albedo, patterned too;
    shadows, glints and things that lie on it are outliers.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear radiance, not divided by any intensity; NaN where saturated.
    lights
        N near lights in the order of the images; their own intensities and `mu` are ignored.
    points_mm
        ``(H, W, 3)`` points of the plane in the house frame.
    mask
        ``(H, W)`` pixels that show the plane.

    Returns
    -------
    IntensityCalibration
        Lights and evidence.

    Raises
    ------
    DataError
        If shapes disagree, the lights are distant, or there is only one.
    EstimateError
        If fewer than 100 pixels are lit by every light, or a light lies where it reaches fewer.
    """
    points = np.asarray(points_mm, np.float64)
    if not lights.near:
        raise DataError("intensities need lights with positions: calibrate those first")
    if len(lights) < 2:
        raise DataError("intensities are relative: 2 lights or more are needed")
    if values.shape != (len(lights), *mask.shape) or points.shape != (*mask.shape, 3):
        raise DataError(
            f"a stack {values.shape}, {len(lights)} lights, a mask {mask.shape} and points "
            f"{points.shape} do not belong together"
        )
    rows, columns = _lit_pixels(values, mask)
    where = points[rows, columns]
    isotropic = replace(lights, intensities=None, mu=None)
    facing = isotropic.vectors_at(where)[..., 2]
    reached = (facing > 0).all(axis=0)
    if np.count_nonzero(reached) < _FEWEST:
        worst = lights.ids[int(np.argmin(np.count_nonzero(facing > 0, axis=1)))]
        raise EstimateError(
            f"light {worst} does not reach the plane where its image is lit: check its position "
            "and axis, and the camera"
        )
    rows, columns = rows[reached], columns[reached]
    where, facing = where[reached], facing[:, reached]
    # The pattern enters only through its exponent: vectors with mu = 1 over those with mu = 0.
    pattern = replace(isotropic, mu=np.ones(len(lights))).vectors_at(where)[..., 2]
    samples = np.log(values[:, rows, columns].astype(np.float64)) - np.log(facing)
    strength, mu, residual = _fit(samples, np.log(pattern) - np.log(facing))
    intensities = np.exp(strength)
    warnings: tuple[str, ...] = ()
    if residual > _POOR_FIT:
        warnings = (
            f"the plane scatters {residual:.1%} about the model: is it matte, and at the working "
            "plane?",
        )
    found = replace(
        lights,
        intensities=intensities / intensities.mean(),
        mu=np.full(len(lights), mu),
    )
    return IntensityCalibration(found, mu, residual, len(where), warnings)


def _lit_pixels(
    values: npt.NDArray[np.float32], mask: npt.NDArray[np.bool_]
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return rows and columns of at most `_PIXELS` pixels, spread evenly over those lit by all."""
    darkest = values.min(axis=0)  # NaN where any light saturates
    lit = mask & (darkest > 0)
    if lit.any():
        lit &= darkest > _DARK * np.median(darkest[lit])
    rows, columns = np.nonzero(lit)
    if len(rows) < _FEWEST:
        raise EstimateError(
            f"{len(rows)} pixels of the plane are lit and unsaturated under every light, at least "
            f"{_FEWEST} are needed: check exposure and mask"
        )
    step = -(-len(rows) // _PIXELS)
    return rows[::step], columns[::step]


def _fit(samples: Array, cosine: Array) -> tuple[Array, float, float]:
    """Fit ``samples = strength[i] + albedo[p] + mu * cosine`` for ``(N, P)`` samples, robustly."""
    weights = np.ones_like(samples)
    strength, mu, scale = np.zeros(len(samples)), 0.0, 0.0
    for _ in range(_ROUNDS):
        rest = samples - mu * cosine
        albedo = _mean(rest - strength[:, None], weights, axis=0)
        strength = _mean(rest - albedo, weights, axis=1)
        # mu by the part of the cosine that no strength and no albedo can imitate.
        free = cosine - _mean(cosine, weights, axis=0)
        free -= _mean(free, weights, axis=1)[:, None]
        residual = rest - strength[:, None] - albedo
        power = float(np.sum(weights * free**2))
        if power > 0:
            mu = max(mu + float(np.sum(weights * free * residual)) / power, 0.0)
        scale = 1.4826 * float(np.median(np.abs(residual)))
        if scale < 1e-12:
            break
        weights = 1 / (1 + (residual / (2.385 * scale)) ** 2)
    return strength - strength.mean(), mu, scale


def _mean(values: Array, weights: Array, axis: int) -> Array:
    mean: Array = np.sum(values * weights, axis=axis) / np.sum(weights, axis=axis)
    return mean
