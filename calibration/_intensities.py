"""Intensities and radiation pattern of near lights from images of a matte plane."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from acquisition import DataError, Lights
from calibration._errors import EstimateError
from calibration._radiance.linear_stack import check_linear
from rig import Notice, check_type, pluralize, short_repr

Array = npt.NDArray[np.float64]

_PIXELS = 20_000
_ROUNDS = 30
# A pixel is in the shadow of some light if its darkest sample is below this fraction of the median.
_DARK = 0.1
_FEWEST = 100
_POOR_FIT = 0.03


@dataclass(frozen=True)
class IntensityCalibration:
    """Lights with their intensities, and the quality of the fit.

    Parameters
    ----------
    lights
        The lights with relative intensities (mean 1) and the common `mu`.
    mu
        Exponent of the radiation pattern, the same for all lights, at least 0.
    residual
        Robust relative deviation of the plane from the model; 0.01 is 1 %.
    pixels
        Number of pixels used.
    warnings
        Doubts about the fit.
    """

    lights: Lights
    mu: float
    residual: float
    pixels: int
    warnings: tuple[Notice, ...]

    __repr__ = short_repr


def calibrate_intensities(
    values: npt.NDArray[np.float32],
    lights: Lights,
    points_mm: npt.ArrayLike,
    mask: npt.NDArray[np.bool_],
) -> IntensityCalibration:
    """Estimate relative intensities and one `mu` from images of a matte plane at z = 0.

    The model of a sample is ``log value = log intensity(light) + log albedo(pixel) + mu * log
    cosine + known geometry`` (the LED model of Queau et al., 2018). It is additive in the logarithm
    and is solved by alternating weighted means with Cauchy weights. The plane may have any albedo,
    including a pattern; shadows, highlights and objects on the plane are outliers.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear radiance, not divided by any intensity; NaN where saturated.
    lights
        N near lights in the order of the images; their intensities and `mu` are ignored.
    points_mm
        ``(H, W, 3)`` points of the plane in the house frame.
    mask
        ``(H, W)`` pixels that show the plane.

    Returns
    -------
    IntensityCalibration
        Lights and quality of the fit.

    Raises
    ------
    DataError
        If shapes differ, the lights are distant, or there is only one light.
    EstimateError
        If fewer than 100 pixels are lit by every light, or a light cannot reach as many from its
        position.

    Examples
    --------
    >>> from calibration import calibrate_intensities
    >>> from simulator import render, scene_named
    >>> rendering = render(scene_named("white-plane", width=32, height=24, leds=4))
    >>> truth = rendering.truth
    >>> points_mm = truth.camera.points_on_plane()
    >>> estimate = calibrate_intensities(rendering.planes, truth.lights, points_mm, truth.mask)
    >>> estimate.residual < 0.01
    True
    """
    check_linear("values", values)
    check_type("lights", lights, Lights, "Lights(positions_mm=positions)")
    points = np.asarray(points_mm, np.float64)
    if not lights.near:
        raise DataError("intensities require lights with positions: calibrate the positions first")
    if len(lights) < 2:
        raise DataError("intensities are relative: at least 2 lights are required")
    if values.shape != (len(lights), *mask.shape) or points.shape != (*mask.shape, 3):
        raise DataError(
            f"the shapes of the stack {values.shape}, the mask {mask.shape} and the points "
            f"{points.shape} do not match each other and {len(lights)} lights"
        )
    rows, columns = _lit_pixels(values, mask)
    where = points[rows, columns]
    isotropic = replace(lights, intensities=None, mu=None)
    facing = isotropic.vectors_at(where)[..., 2]
    reached = (facing > 0).all(axis=0)
    if np.count_nonzero(reached) < _FEWEST:
        worst = lights.ids[int(np.argmin(np.count_nonzero(facing > 0, axis=1)))]
        raise EstimateError(
            f"light {worst} cannot reach the lit pixels of its image from its position: check its "
            "position and axis, and the camera"
        )
    rows, columns = rows[reached], columns[reached]
    where, facing = where[reached], facing[:, reached]
    # The cosine of the pattern is the ratio of the vectors with mu = 1 to those with mu = 0.
    pattern = replace(isotropic, mu=np.ones(len(lights))).vectors_at(where)[..., 2]
    samples = np.log(values[:, rows, columns].astype(np.float64)) - np.log(facing)
    strength, mu, residual = _fit(samples, np.log(pattern) - np.log(facing))
    intensities = np.exp(strength)
    warnings: tuple[Notice, ...] = ()
    if residual > _POOR_FIT:
        text = (
            f"the plane deviates from the model by {residual:.1%}: check that it is matte and in "
            "the working plane"
        )
        warnings = (Notice("plane-deviates", text),)
    calibrated = replace(
        lights,
        intensities=intensities / intensities.mean(),
        mu=np.full(len(lights), mu),
        errors=None if lights.errors is None else lights.errors.without_strengths(),
    )
    return IntensityCalibration(calibrated, mu, residual, len(where), warnings)


def _lit_pixels(
    values: npt.NDArray[np.float32], mask: npt.NDArray[np.bool_]
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return rows and columns of up to `_PIXELS` pixels, evenly spread over those lit by all."""
    darkest = values.min(axis=0)  # NaN if the pixel is saturated under any light
    lit = mask & (darkest > 0)
    if lit.any():
        lit &= darkest > _DARK * np.median(darkest[lit])
    rows, columns = np.nonzero(lit)
    if len(rows) < _FEWEST:
        raise EstimateError(
            f"{pluralize(len(rows), 'pixel of the plane is', 'pixels of the plane are')} lit and "
            f"unsaturated under every light, at least {_FEWEST} are required: check the exposure "
            "and the mask"
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
        # Fit mu to the part of the cosine that neither strength nor albedo can explain.
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
