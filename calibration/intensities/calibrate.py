"""Intensities, axes and radiation patterns of near lights from images of matte surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from acquisition import DataError, LightErrors, Lights
from acquisition.values import tangent_basis
from calibration.intensities.blocks import Blocks, blocks_of
from calibration.intensities.fit import Fit, Vignetting, covariance_of, fit_vignetting
from calibration.intensities.model import Geometry, NormalEquations, position_slopes
from calibration.intensities.surface import MatteSurface
from rig import Notice, check_type, listed, pluralize
from rig.arrays import Bool, Float64

# A gloss or a shape that moves samples by 1 % moves intensities by nearly as much.
_POOR_FIT = 0.03
_SMOOTH_MISFIT = 0.01
# Positions that are all too high by 1 mm look like a card that is 1 mm too low, and positions from
# spheres have common errors of this size. 3 mm change intensities by 0.5 % in a dome of 450 mm.
_LEAST_MM = 3.0
_CONFIDENCE = 0.9999
_FEWEST_LIGHTS = 4
# LEDs are soldered to a few degrees. What turns an axis much farther than those of the other lights
# is a bent LED, or a position that is not that of the light.
_LEAST_DEG, _TYPICAL = 5.0, 6.0
_LISTED = 4


@dataclass(frozen=True)
class IntensityCalibration:
    """Lights with their intensities and patterns, and the quality of the fit.

    Parameters
    ----------
    lights
        The lights with relative intensities (mean 1 in each channel), axes and `mu`, and their
        standard deviations in `Lights.errors`.
    mu
        Mean exponent of the radiation pattern, at least 0.
    own_mu, own_axis
        ``(N,)`` whether a light has its own value. Otherwise it has the `mu` that such lights
        share, or the axis before the fit, and the spread as standard deviation.
    mu_spread, axis_spread_deg
        Standard deviation of `mu` and of a component of the axis among the lights.
    residual
        Robust relative deviation of the surface from the model; 0.01 is 1 %. Pixels are averaged
        over blocks.
    pixels
        Number of pixels used.
    vignetting
        Fall of brightness toward the corners of the image; None if it is not determined.
    warnings
        Doubts about the fit.
    """

    lights: Lights
    mu: float
    own_mu: Bool
    own_axis: Bool
    mu_spread: float
    axis_spread_deg: float
    residual: float
    pixels: int
    vignetting: Vignetting | None
    warnings: tuple[Notice, ...]

    def __repr__(self) -> str:
        return (
            f"IntensityCalibration({self.lights!r}, mu {self.mu:.2f}, residual "
            f"{self.residual:.2%}, {pluralize(self.pixels, 'pixel')})"
        )


@dataclass(frozen=True, eq=False)
class FittedSurfaces:
    """A fit of strengths and patterns to surfaces.

    Parameters
    ----------
    fit
        The fit, which has run.
    blocks
        The blocks it was fitted to.
    lights
        The lights with the fitted strengths and patterns, without errors.
    covariance
        Of the n unknowns of the fit, see `NormalEquations`.
    slopes
        ``(3, K, P)`` derivatives of the logarithm of the values by the positions, per mm.
    by_positions
        ``(n, 3, K)`` derivatives of the unknowns by the positions, per mm.
    warnings
        Doubts about the fit.
    """

    fit: Fit
    blocks: Blocks
    lights: Lights
    covariance: Float64
    slopes: Float64
    by_positions: Float64
    warnings: tuple[Notice, ...]


def fit_surfaces(surfaces: Sequence[MatteSurface], lights: Lights) -> FittedSurfaces:
    """Fit strengths and radiation patterns of lights to surfaces; see `calibrate_intensities`.

    Raises
    ------
    DataError, EstimateError
        As `calibrate_intensities`.
    """
    _check(surfaces, lights)
    if lights.errors is not None and lights.errors.axis_std_deg is not None:
        lights = replace(lights, axes=None)  # estimated before, perhaps from the same images
    blocks = blocks_of(surfaces, lights)
    fit = Fit(blocks.values, Geometry.of(lights, blocks.points_mm, blocks.normals))
    fit.run()
    calibrated = _lights(lights, fit)
    slopes = position_slopes(calibrated, blocks.points_mm, blocks.normals)
    known = None if lights.errors is None else lights.errors.covariances
    covariance, by_positions = covariance_of(fit, slopes, known)
    warnings = doubts(fit, blocks, lights)
    return FittedSurfaces(fit, blocks, calibrated, covariance, slopes, by_positions, warnings)


def calibrate_intensities(
    surfaces: MatteSurface | Sequence[MatteSurface], lights: Lights, *, even: bool = False
) -> IntensityCalibration:
    """Estimate relative intensities and radiation patterns from images of matte surfaces.

    The value of a pixel is ``intensity * albedo * n.l / r^2 * (cos t / cos t0)^mu``, the LED model
    of Queau et al. (2018). The albedo of each pixel and channel is free, so that surfaces may have
    any pattern, and vignetting and the exposure of a recording cancel. Shadows, highlights and
    objects on a surface are outliers with a low weight (Cauchy). `mu` and axis differ between
    lights by a normal distribution whose width is estimated (MacKay, Bayesian interpolation,
    1992). Standard deviations are those of a sandwich estimate (Huber, 1981) plus the propagated
    covariances of the positions, if `Lights.errors` has them; errors of different positions count
    as independent. They do not include deviations of the surface from the model.

    Parameters
    ----------
    surfaces
        Cards or balls, each under all lights in the order of ``lights``; all gray or all RGB.
    lights
        N near lights; their intensities and `mu` are ignored. Axes are fitted around their axes, or
        around the directions to the origin if the axes are estimates with standard deviations.
    even
        Whether the albedo of each surface is the same everywhere, to determine the vignetting.

    Returns
    -------
    IntensityCalibration
        Lights and quality of the fit. Intensities are relative to their mean over the lights, in
        each channel: the colour of the lights as a whole is not determined.

    Raises
    ------
    DataError
        If shapes differ, the lights are distant, or there is only one light.
    EstimateError
        If fewer than 100 pixels are lit, a light does not reach as many, or a channel is dead.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import CameraModel, Lights
    >>> from calibration import MatteSurface, calibrate_intensities
    >>> camera = CameraModel(np.array([[90, 0, 31.5], [0, 90, 23.5], [0, 0, 1]]), 64, 48, 500)
    >>> lamps = Lights(
    ...     positions_mm=np.array([[200, 0, 300], [0, 250, 300], [-200, 0, 300], [0, -250, 300]])
    ... )
    >>> irradiance = lamps.vectors_at(camera.points_on_plane())[..., 2]
    >>> images = (np.array([2, 1, 1, 4])[:, None, None] * irradiance).astype(np.float32)
    >>> found = calibrate_intensities(MatteSurface.card(images, camera), lamps)
    >>> found.lights.intensities[:, 0].round(3)
    array([1. , 0.5, 0.5, 2. ])
    """
    check_type("lights", lights, Lights, "Lights(positions_mm=positions)")
    parts = [surfaces] if isinstance(surfaces, MatteSurface) else list(surfaces)
    for part in parts:
        check_type("surfaces", part, MatteSurface, "MatteSurface.card(values, camera)")
    fitted = fit_surfaces(parts, lights)
    fit, covariance, calibrated = fitted.fit, fitted.covariance, fitted.lights
    errors = _errors(fit, covariance, np.asarray(calibrated.intensities), lights.errors)
    return IntensityCalibration(
        replace(calibrated, errors=errors),
        float(fit.mu.mean()),
        fit.own_mu,
        fit.own_tilt,
        fit.spreads[0],
        float(np.degrees(fit.spreads[1])),
        fit.scale,
        fitted.blocks.pixels,
        fit_vignetting(fit, fitted.blocks, covariance) if even else None,
        fitted.warnings,
    )


def _check(surfaces: Sequence[MatteSurface], lights: Lights) -> None:
    if not lights.near:
        raise DataError("intensities require lights with positions: calibrate the positions first")
    if len(lights) < 2:
        raise DataError("intensities are relative: at least 2 lights are required")
    if not surfaces:
        raise DataError("no surface: give images of at least one card or ball")
    for surface in surfaces:
        if len(surface.values) != len(lights):
            raise DataError(
                f"{pluralize(len(surface.values), 'image')} of a card for "
                f"{pluralize(len(lights), 'light')}: every light needs one image"
            )
        if surface.values.ndim != surfaces[0].values.ndim:
            raise DataError("the images of one surface are gray, of another RGB: use one of them")


def _lights(lights: Lights, fit: Fit) -> Lights:
    """Return the lights with the fitted strengths and patterns."""
    intensities = np.exp(fit.strength - fit.strength.mean(axis=1, keepdims=True)).T
    intensities = intensities / intensities.mean(axis=0)
    axes = np.asarray(lights.axes)
    turned = axes + np.einsum("jk,kji->ki", fit.tilt, tangent_basis(axes))
    return replace(
        lights,
        intensities=np.repeat(intensities, 3 // intensities.shape[1], axis=1),
        axes=turned,
        mu=fit.mu,
        errors=None,
    )


def _errors(
    fit: Fit, covariance: Float64, intensities: Float64, given: LightErrors | None
) -> LightErrors:
    channels, lights = fit.strength.shape
    deviations = np.zeros((lights, 3))
    for c in range(3):
        own = slice((c % channels) * lights, (c % channels + 1) * lights)
        # The intensities are divided by their mean, whose error is subtracted.
        strength = intensities[:, c]
        change = np.diag(strength) @ (np.eye(lights) - strength / lights)
        deviations[:, c] = np.sqrt(np.diag(change @ covariance[own, own] @ change.T))
    variance = np.diag(covariance)[channels * lights :].reshape(3, lights)
    return replace(
        LightErrors() if given is None else given,
        intensity_std=deviations,
        mu_std=np.sqrt(variance[0]),
        axis_std_deg=np.degrees(np.sqrt(variance[1:].mean(axis=0))),
    )


def doubts(fit: Fit, blocks: Blocks, lights: Lights) -> tuple[Notice, ...]:
    """Return what contradicts the model, at most one notice of each kind."""
    found = []
    residuals, *_ = fit.residuals()
    smooth = _smooth_misfit(np.where(np.isfinite(fit.values), residuals, np.nan), fit.scale)
    if fit.scale > _POOR_FIT or smooth > _SMOOTH_MISFIT:
        text = (
            f"the plane deviates from the model by {fit.scale:.1%}: check that it is matte and in "
            "the working plane"
        )
        found.append(Notice("plane-deviates", text))
    height = _height(fit, blocks, lights) if blocks.cards else None
    if height is not None:
        text = (
            f"the card is about {abs(height[0]):.1f} mm (standard deviation {height[1]:.1f}) "
            f"{'higher' if height[0] > 0 else 'lower'} than stated, or positions or axes of all "
            "lights are off alike: check the height of its upper side"
        )
        found.append(Notice("card-off-plane", text))
    return (*found, *_unlike(fit, lights))


def _unlike(fit: Fit, lights: Lights) -> list[Notice]:
    """Return a notice about lights whose axes are turned much farther than those of the others."""
    turned = np.degrees(np.arctan(np.hypot(*fit.tilt)))
    usual = float(np.median(turned))
    odd = np.flatnonzero(turned > max(_LEAST_DEG, _TYPICAL * usual))
    if not len(odd):
        return []
    named = listed([f"{lights.ids[k]} ({turned[k]:.0f} degrees)" for k in odd], _LISTED)
    text = (
        f"the images turn the axis of {named} away from the given one, those of half of the "
        f"lights by less than {max(usual, 0.1):.1f} degrees: unless this LED is bent, its position "
        "is wrong, or that of another light: check the order of wires and images"
    )
    return [Notice("axis-unlike", text)]


def _smooth_misfit(
    residuals: np.ndarray[tuple[int, ...], np.dtype[np.float64]], scale: float
) -> float:
    """Return the part of the residuals that neighbouring blocks share."""
    step = np.abs(np.diff(residuals, axis=2))
    noise = 1.4826 * float(np.nanmedian(step)) / np.sqrt(2) if np.isfinite(step).any() else scale
    return float(np.sqrt(max(scale**2 - noise**2, 0.0)))


def _height(fit: Fit, blocks: Blocks, lights: Lights) -> tuple[float, float] | None:
    """Return by how much cards are too high, and its standard deviation; None if they are not.

    A wrong height tilts the fitted axes of all lights in a pattern that is known. Its size is
    fitted to the tilts, whose other causes (real tilts, errors of positions) are its noise.
    """
    count = len(lights)
    if count < _FEWEST_LIGHTS or not fit.own_tilt.all():
        return None
    raised = Geometry.of(lights, blocks.points_mm + blocks.upward, blocks.normals)
    ratio, _ = fit.geometry.pattern(fit.tilt)
    higher, _ = raised.pattern(fit.tilt)
    slope = raised.fall_off - fit.geometry.fall_off + fit.mu[:, None] * (higher - ratio)
    residuals, weights, _, columns = fit.residuals()
    slope = np.where(np.isfinite(slope), slope, 0.0)
    equations = NormalEquations.of(residuals, weights, np.concatenate([columns, slope[None]]))
    size = fit.strength.size + 3 * count
    cross = equations.matrix[:size, size:].sum(axis=1)
    precision, _ = fit.prior()
    # The tilts that the fit finds if the card is 1 mm higher than stated.
    pattern = np.linalg.solve(equations.matrix[:size, :size] + precision, cross)[-2 * count :]
    tilts = fit.tilt.ravel()
    power = float(pattern @ pattern)
    height = float(pattern @ tilts) / power
    freedom = 2 * count - 1
    rest = float(np.sum((tilts - height * pattern) ** 2)) / freedom
    deviation = float(np.sqrt(rest / power))
    limit = float(stdtrit(freedom, (1 + _CONFIDENCE) / 2)) * deviation
    return (height, deviation) if abs(height) > max(limit, _LEAST_MM) else None
