"""Strengths of lights from images of an object of unknown shape."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from acquisition import DataError, LightErrors, Lights
from calibration import EstimateError, Stack
from calibration.radiance import check_linear
from processing.images.block_means import cells_of
from processing.noise.normal_errors import STRUCTURED
from processing.noise.reference_solver import correlation_of_neighbours
from processing.series.strength_fit import (
    StrengthFit,
    fit_strengths,
    light_vectors,
    solve_normals,
)
from processing.stereo.light_model import check_one_light_each
from rig import Notice, check_type, pluralize, short_repr
from rig.arrays import Bool, Float32, Float64, Intp

_FEWEST_LIGHTS = 4
_FEWEST_PIXELS = 100
_PIXELS = 2000
# Pixels near one another deviate alike, on glossy objects over a highlight: scores are added up in
# so many tiles per axis. Fewer would scatter too much themselves.
_TILES = 6
# Standard deviations of logarithms that are refused, and reported.
_UNKNOWN = 0.1
_UNCERTAIN = 0.03
# A light is outside of the plane of the others by this sine at least.
_LEAST_SINE = 0.05
# Of directions of normals, the larger standard deviation: 0.02 is 1 degree.
_LEAST_RELIEF = 0.02


@dataclass(frozen=True, eq=False)
class LightStrengths:
    """Lights whose intensities were estimated from images of an object.

    Parameters
    ----------
    lights
        The lights with the estimated intensities; their ``errors`` contain the standard deviations.
        The mean of the logarithms of all intensities is that of the given ones.
    factors
        ``(N,)`` estimated relative to given intensities; their geometric mean is 1.
    sigmas
        ``(N,)`` relative standard deviations of the factors, from the scatter between pixels and
        between parts of the object. Under near lights whose height was found with the strengths,
        they contain 1 % for the error of this height, 7 % if the object is not matte.
    warnings
        Strengths that the images determine only roughly, and surfaces that are not matte.
    """

    lights: Lights
    factors: Float64
    sigmas: Float64
    warnings: tuple[Notice, ...]

    __repr__ = short_repr

    def refined(self, again: LightStrengths) -> LightStrengths:
        """Return these strengths times those of images that were divided by them."""
        factors = self.factors * again.factors
        return LightStrengths(
            _scaled(self.lights, again.factors, again.sigmas), factors, again.sigmas, again.warnings
        )

    def less_certain(self, sigma: float) -> LightStrengths:
        """Return the same strengths with another independent relative error."""
        sigmas = np.hypot(self.sigmas, sigma)
        lights = _scaled(self.lights, np.ones_like(sigmas), sigmas)
        return LightStrengths(lights, self.factors, sigmas, self.warnings)

    def divided(self, stack: Stack) -> Stack:
        """Return a stack under the estimated strengths."""
        noise = stack.noise
        if noise is not None:
            noise = replace(noise, intensities=noise.intensities * self.factors[:, None])
        factors = self.factors.astype(np.float32)
        shape = (-1,) + (1,) * (stack.values.ndim - 1)
        return replace(stack, values=stack.values / factors.reshape(shape), noise=noise)


def of_source(strengths: LightStrengths, given: Lights) -> LightStrengths:
    """Return strengths whose lights have the positions of those of a source, if these have any."""
    used = given.take([given.ids.index(name) for name in strengths.lights.ids])
    one = np.ones(len(used))
    lights = replace(used, intensities=strengths.lights.intensities)
    return replace(strengths, lights=_scaled(lights, one, strengths.sigmas))


def with_strengths(given: Lights | None, estimated: Lights) -> Lights | None:
    """Return the lights of a source with the estimated intensities of those that were used."""
    if given is None or given.intensities is None or estimated.intensities is None:
        return given
    intensities = given.intensities.copy()
    places = [given.ids.index(name) for name in estimated.ids]
    intensities[places] = estimated.intensities
    return replace(given, intensities=intensities)


def light_strengths(
    values: Float32,
    lights: Lights,
    mask: Bool,
    *,
    points_mm: Float64 | None = None,
) -> LightStrengths:
    """Estimate the strengths of lights from images of an object of unknown shape.

    Normals, albedo and strengths are fitted to the same samples (semi-calibrated photometric
    stereo; Cho et al., 2018), with Cauchy weights: highlights and shadows have little influence.
    The images do not show a common factor of all strengths: it is chosen so that the geometric mean
    of the strengths does not change. With known directions there is no bas-relief ambiguity: a
    linear map of all normals keeps the images only if it maps the direction of each light to a
    multiple of itself, and for four directions of which no three are in a plane only multiples of
    the identity do.

    Parameters
    ----------
    values
        ``(N, H, W)`` float32 linear radiance, divided by the intensities of the lights. NaN where
        saturated.
    lights
        The N lights.
    mask
        ``(H, W)`` bool, the object.
    points_mm
        ``(H, W, 3)`` surface points for lights with positions, as for `photometric_stereo`.

    Returns
    -------
    LightStrengths
        Lights with new intensities, and their standard deviations.

    Raises
    ------
    DataError
        If shapes or counts differ, the mask is empty, or near lights have no points.
    EstimateError
        If there are fewer than 4 lights, a light is the only one outside of a plane, or the object
        is too flat or too small.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Lights
    >>> from processing.series import light_strengths
    >>> lights = Lights(directions=[[1, 0, 1], [0, 1, 1], [-1, 0, 1], [0, -1, 1], [0, 0, 1]])
    >>> y, x = np.mgrid[0.5:-0.5:40j, -0.5:0.5:40j]
    >>> normals = np.dstack([x, y, np.sqrt(1 - x**2 - y**2)])
    >>> shading = np.einsum("nk,hwk->nhw", lights.unit_directions, normals).clip(0)
    >>> values = shading * np.reshape([1, 2, 1, 0.5, 1], (5, 1, 1))
    >>> light_strengths(values.astype(np.float32), lights, np.ones((40, 40), bool)).factors.round(3)
    array([1. , 2. , 1. , 0.5, 1. ])
    """
    check_linear("values", values)
    check_type("lights", lights, Lights, "Lights(directions)")
    _check(values, lights, mask, points_mm)
    cells = cells_of(values, mask, points_mm)
    places = np.flatnonzero(cells.mask)
    some = places[:: max(1, -(-len(places) // _PIXELS))]
    fit = None
    if len(some):
        vectors = light_vectors(lights, cells.points_mm, some)
        _check_planes(vectors.mean(axis=0), lights.ids)
        seen = cells.values.reshape(len(lights), -1)[:, some].T.astype(np.float64)
        fit = fit_strengths(seen, vectors)
    if fit is None or len(fit.kept) < _FEWEST_PIXELS:
        raise EstimateError(
            "too few pixels are lit by half of the lights to estimate strengths: at least "
            f"{_FEWEST_PIXELS} are required"
        )
    if _relief(fit) < _LEAST_RELIEF:
        raise EstimateError(
            "the object is too flat to show strengths of lights: under other strengths, a plane "
            "looks like a plane in another direction; use an object with relief"
        )
    sigmas = _sigmas(fit, some[fit.kept], cells.mask.shape)
    if not np.max(sigmas) < _UNKNOWN:
        worst = int(np.argmax(sigmas))
        raise EstimateError(
            f"the images do not determine the strength of {lights.ids[worst]} (standard deviation "
            f"{min(sigmas[worst], 9.99):.0%}): use more lights, or an object with more relief"
        )
    factors = np.exp(fit.logarithms - fit.logarithms.mean())
    uncertain = np.flatnonzero(sigmas > _UNCERTAIN)
    warnings = []
    if len(uncertain):
        worst = int(np.argmax(sigmas))
        text = (
            f"the strengths of {pluralize(len(uncertain), 'light')} are known only roughly, that "
            f"of {lights.ids[worst]} to {sigmas[worst]:.1%}"
        )
        warnings.append(Notice("strengths-uncertain", text, lights.ids[worst]))
    residuals = np.where(fit.weights > 0, fit.residuals, 0.0)
    correlation = correlation_of_neighbours(residuals, fit.vectors.mean(axis=0))
    if correlation > STRUCTURED:
        text = (
            f"neighbouring lights have similar residuals (correlation {correlation:.2f}; noise has "
            f"less than {STRUCTURED:g}): the surface is not matte, and the strengths may be wrong "
            "by more than their standard deviations; use a matte object"
        )
        warnings.append(Notice("strengths-not-matte", text))
    return LightStrengths(_scaled(lights, factors, sigmas), factors, sigmas, tuple(warnings))


def _check(
    values: Float32,
    lights: Lights,
    mask: Bool,
    points_mm: Float64 | None,
) -> None:
    if values.ndim != 3 or values.shape[1:] != mask.shape:
        raise DataError(
            f"images of shape {values.shape} do not fit a mask of shape {mask.shape}: they must be "
            "(N, H, W)"
        )
    check_one_light_each(len(values), lights)
    if not mask.any():
        raise DataError("the mask is empty: there is no pixel to compute")
    if lights.near and points_mm is None:
        raise DataError("lights with positions need surface points")
    if len(lights) < _FEWEST_LIGHTS:
        raise EstimateError(
            f"{pluralize(len(lights), 'light')}: with fewer than {_FEWEST_LIGHTS}, some normals "
            "explain the images for any strengths"
        )


def _check_planes(vectors: Float64, ids: tuple[str, ...]) -> None:
    """Refuse lights of which one is the only one outside of a plane."""
    unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    for i, name in enumerate(ids):
        others = np.delete(unit, i, axis=0)
        least = np.linalg.svd(others, compute_uv=False)[2] / np.sqrt(len(others))
        if least < _LEAST_SINE:
            raise EstimateError(
                f"without {name}, the lights are in one plane: any strength of {name} explains the "
                "images with other normals; add lights outside of the plane"
            )


def _sigmas(fit: StrengthFit, places: Intp, shape: tuple[int, ...]) -> Float64:
    """Return standard deviations from the scatter between pixels, or parts if they scatter more."""
    rows, columns = np.divmod(places, shape[1])
    tiles = [
        np.minimum((at - at.min()) * _TILES // max(int(np.ptp(at)) + 1, 1), _TILES - 1)
        for at in (rows, columns)
    ]
    parts = np.zeros((_TILES**2, fit.scores.shape[1]))
    np.add.at(parts, tiles[0] * _TILES + tiles[1], fit.scores)
    of_pixels, of_parts = (np.diag(fit.covariance(scores)) for scores in (fit.scores, parts))
    return np.asarray(np.sqrt(np.maximum(np.maximum(of_pixels, of_parts), 0)))


def _relief(fit: StrengthFit) -> float:
    """Return the larger standard deviation of the directions of normals, without that of noise."""
    length = np.maximum(np.linalg.norm(fit.scaled_normals, axis=1), 1e-12)
    unit = fit.scaled_normals / length[:, None]
    _, inverse = solve_normals(fit.samples, fit.weights, fit.vectors)
    noise = np.mean(inverse * ((fit.spread / length) ** 2)[:, None, None], axis=0)
    across = np.linalg.svd(unit.mean(axis=0)[None])[2][1:]
    left = across @ (np.cov(unit.T) - noise) @ across.T
    return float(np.sqrt(np.maximum(np.linalg.eigvalsh(left)[1], 0)))


def _scaled(lights: Lights, factors: Float64, sigmas: Float64) -> Lights:
    intensities = np.asarray(lights.intensities) * factors[:, None]
    errors = LightErrors() if lights.errors is None else lights.errors
    return replace(
        lights,
        intensities=intensities,
        errors=replace(errors, intensity_std=intensities * sigmas[:, None]),
    )
