"""Search for the mean height at which a surface explains its images under near lights best."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from acquisition import Lights
from calibration import EstimateError
from processing.images.coarse_images import CoarseImages, coarse_images
from processing.images.recorded_images import Images
from processing.images.viewing_rays import View
from processing.noise.reference_solver import correlation_of_neighbours
from processing.series.strength_fit import fit_strengths
from processing.stereo.frames import Frames
from processing.stereo.light_model import LightModel
from processing.stereo.method import Method
from processing.stereo.solve import solve_maps
from processing.stereo.stereo_maps import StereoMaps
from rig import no_progress
from rig.arrays import Bool, Float32, Float64, Intp

_STRENGTH_PIXELS = 250
_STRENGTH_TRIED = 13
# Of heights, relative to the range: a millimetre changes strengths by 0.2 %.
_ACCURACY = 1e-3
# Pixels that show the mean height.
_SAMPLED = 2500
# The albedo and the normal of a pixel explain three samples at any height, and a fourth one hardly
# tests them. Samples count as lit above a share of the brightest one.
_FEWEST_LIT = 5
_LIT = 0.05
_FEWEST_PIXELS = 20
_TRIED = 21
_ACCURACY_MM = 0.01
# The reflectance that `best` fits would take up what a wrong height does to the samples.
_METHOD: Method = "cauchy"
# Shift of all lights in differences of the cost, relative to their distance.
_SHIFT = 0.013


class HeightWithStrengths:
    """Finds the mean height at which a surface and any strengths explain the images best.

    Strengths that are fitted at a wrong height explain the mean fall-off of each light, so that the
    images seem to be those of a surface at this height. Only its change over the object shows the
    height: strengths, normals and height have to be fitted together.

    Parameters
    ----------
    values
        N images of linear radiance.
    lights
        N lights with positions.
    mask
        ``(H, W)`` bool, the object.
    view
        How the pixels see the surface.
    limits
        Lowest and highest mean height, mm.
    """

    def __init__(
        self, values: Images, lights: Lights, mask: Bool, view: View, limits: tuple[float, float]
    ) -> None:
        coarse = coarse_images(values, mask, view)
        places = np.flatnonzero(coarse.mask)
        places = places[:: max(1, -(-len(places) // _STRENGTH_PIXELS))]
        self._values = coarse.values.reshape(len(lights), -1)[:, places].T.astype(np.float64)
        self._origins, self._rays = (
            of.reshape(-1, 3)[places] for of in (coarse.origins, coarse.rays)
        )
        rows, columns = np.divmod(places, coarse.mask.shape[1])
        self._pixels = tuple(coarse.factor * at + coarse.factor // 2 for at in (rows, columns))
        self._lights, self._view, self._limits = lights, view, limits
        self._spacing = (limits[1] - limits[0]) / (_STRENGTH_TRIED - 1)
        self._scale = 0.0

    def best(self, depth: Float32, found: float | None) -> float | None:
        """Return the best mean height of a surface of known shape; None if it is at a limit.

        Parameters
        ----------
        depth
            ``(H, W)`` depths of the surface.
        found
            The height that was found before, near which the new one is; None for the first time.
        """
        shape = depth[self._pixels].astype(np.float64)
        around = None if found is None else (found - self._spacing, found + self._spacing)
        accuracy = _ACCURACY * (self._limits[1] - self._limits[0])
        cost = partial(self._cost, shape)
        return _least_cost(cost, self._limits, _STRENGTH_TRIED, around, accuracy)

    def _cost(self, shape: Float64, height: float) -> float:
        depth = self._view.moved(shape, float(shape.mean()), self._view.distance_mm - height)
        points = self._origins + depth[:, None] * self._rays
        fit = fit_strengths(self._values, self._lights.vectors_at(points).transpose(1, 0, 2))
        if fit is None:
            return float("inf")
        if not self._scale:
            self._scale = max(float(np.median(fit.spread)), 1e-6)
        measured = fit.samples > 0
        cost = np.log1p(np.where(measured, fit.residuals / self._scale, 0.0) ** 2)
        return float(np.mean(cost.sum(axis=1) / measured.sum(axis=1)))


def raised(lights: Lights, rise_mm: float) -> Lights:
    """Return lights with positions that are all higher."""
    return replace(
        lights, positions_mm=np.asarray(lights.positions_mm) + np.array([0.0, 0.0, rise_mm])
    )


class MeanHeightSearch:
    """Finds the mean height of a surface of known shape."""

    def __init__(
        self,
        coarse: CoarseImages,
        lights: Lights,
        limits: tuple[float, float],
    ) -> None:
        self.coarse, self.lights = coarse, lights
        flat = coarse.values.reshape(len(coarse.values), -1)
        pixels = np.flatnonzero(coarse.mask)
        pixels = pixels[_lit(flat[:, pixels]) >= _FEWEST_LIT]
        self._pixels = pixels[:: max(1, len(pixels) // _SAMPLED)]
        self._values = np.ascontiguousarray(flat[:, self._pixels][:, None])
        measured = np.maximum(np.nan_to_num(self._values[:, 0]), 0)
        self._brightness = np.maximum(measured.mean(axis=0), np.finfo(np.float32).tiny)[:, None]
        self._rays = coarse.rays.reshape(-1, 3)[self._pixels]
        self._origins = coarse.origins.reshape(-1, 3)[self._pixels]
        self._view = coarse.view
        self._limits = limits
        positions = np.asarray(lights.positions_mm)
        self.light_distance_mm = float(np.mean(np.linalg.norm(positions, axis=1)))
        self._scale = 1.0
        self._spacing = (limits[1] - limits[0]) / (_TRIED - 1)
        # The best mean height so far.
        self._found: float | None = None

    def moved(self, depth: Float64) -> tuple[Float64, float]:
        """Return the depth at the best mean height, and the standard deviation of the height."""
        if len(self._pixels) < _FEWEST_PIXELS:
            return depth, math.inf
        shape = depth.reshape(-1)[self._pixels]
        mean = float(shape.mean())
        distance = self._view.distance_mm
        residuals = self._residuals(shape, distance - mean, self.lights)
        known = residuals[np.isfinite(residuals)]
        if not known.size:
            return depth, math.inf
        self._scale = max(1.4826 * float(np.median(np.abs(known))), 1e-6)

        def cost(height: float) -> float:
            return float(self._costs(shape, height).sum())

        around = None
        if self._found is not None:
            # The surface has moved by a few millimetres since.
            around = self._found - self._spacing / 2, self._found + self._spacing / 2
        height = _least_cost(cost, self._limits, _TRIED, around, _ACCURACY_MM)
        at_limit = height is None
        if height is None:
            # The shape of a tall object may bring it inside.
            height = min(self._limits, key=cost)
        else:
            self._found = height
        sigma = math.inf if at_limit else self._sigma(shape, height)
        return self._view.moved(depth, mean, distance - height), sigma

    def _sigma(self, shape: Float64, height: float) -> float:
        """Return the standard deviation of a minimum.

        Slopes of the cost scatter between pixels by noise, and between lights also by errors of the
        lights, which are common to all pixels (a sandwich estimate, by clusters; White, 1982).
        """
        step = max(0.002 * self.light_distance_mm, 10 * _ACCURACY_MM)
        below, here, above = (self._costs(shape, height + shift) for shift in (-step, 0.0, step))
        curvature = float(np.sum(above + below - 2 * here)) / step**2
        if not curvature > 0:
            return math.inf
        slopes = (above - below) / (2 * step)
        variances = []
        for axis in (0, 1):
            of_one = slopes.sum(axis=axis)
            free = max(len(of_one) - 4, 1) / len(of_one)
            variances.append(float(np.sum((of_one - of_one.mean()) ** 2)) / free)
        return math.sqrt(max(variances)) / curvature

    def under(self, lights: Lights) -> MeanHeightSearch:
        """Return the same search under other lights, near the height that was found."""
        other = MeanHeightSearch(self.coarse, lights, self._limits)
        other._found = self._found
        return other

    def neighbour_correlation(self, depth: Float64) -> float:
        """Return the correlation of the residuals of neighbouring lights at a surface."""
        shape = depth.reshape(-1)[self._pixels]
        middle = self._origins.mean(axis=0) + float(shape.mean()) * self._rays.mean(axis=0)
        residuals = self._residuals(shape, self.mean_height(depth), self.lights)
        return correlation_of_neighbours(np.nan_to_num(residuals), self.lights.vectors_at(middle))

    def mean_height(self, depth: Float64) -> float:
        """Return the mean height of the pixels that show it."""
        return self._view.distance_mm - float(depth.reshape(-1)[self._pixels].mean())

    def common_shift(self, depth: Float64) -> tuple[float, float]:
        """Estimate a shift of all lights together with a mean height, by one step of Newton.

        Returns
        -------
        tuple
            The shift along Z with which images agree best, and its standard deviation. It is a
            small part of the true one, because the surface, which is bent under wrong lights, stays
            as it is.
        """
        shape, height = depth.reshape(-1)[self._pixels], self.mean_height(depth)
        step_mm = _SHIFT * self.light_distance_mm

        def at(rise: int, shift: int) -> Float64:
            lights = raised(self.lights, shift * step_mm)
            return self._costs(shape, height + rise * step_mm, lights)

        here, higher, lower, up, down = at(0, 0), at(1, 0), at(-1, 0), at(0, 1), at(0, -1)
        mixed = np.sum(at(1, 1) + at(-1, -1) - at(1, -1) - at(-1, 1)) / 4
        by_height, by_shift = (np.sum(pair - 2 * here) for pair in (higher + lower, up + down))
        curvature = np.array([[by_height, mixed], [mixed, by_shift]]) / step_mm**2
        if not (by_height > 0 and np.linalg.det(curvature) > 0):
            return 0.0, np.inf
        inverse = np.linalg.inv(curvature)
        slopes = np.stack([higher - lower, up - down]) / (2 * step_mm)
        best = -inverse @ slopes.sum(axis=(1, 2))
        variances = []
        # Between pixels by noise, between lights also by their errors, see `MeanHeightSearch`.
        for axis in (1, 2):
            of_one = slopes.sum(axis=axis)
            free = max(of_one.shape[1] - 4, 1) / of_one.shape[1]
            scatter = of_one - of_one.mean(axis=1, keepdims=True)
            variances.append(float((inverse @ (scatter @ scatter.T / free) @ inverse)[1, 1]))
        return float(best[1]), float(np.sqrt(max(variances)))

    def _costs(self, shape: Float64, height: float, lights: Lights | None = None) -> Float64:
        """Return the cost of each sample ``(P, N)`` at a mean height, 0 where it is missing."""
        ratio = self._residuals(shape, height, lights or self.lights) / self._scale
        measured = np.isfinite(ratio)
        cost = np.log1p(np.where(measured, ratio, 0.0) ** 2)
        # A pixel counts alike, however many samples it has.
        return np.asarray(cost / np.maximum(measured.sum(axis=1), 1)[:, None], np.float64)

    def _residuals(self, shape: Float64, height: float, lights: Lights) -> Float64:
        """Return residuals ``(P, N)`` relative to the brightness, NaN where a sample is missing.

        Residuals relative to the albedo would be smaller at lower heights, as is the irradiance.
        """
        depth = self._view.moved(shape, float(shape.mean()), self._view.distance_mm - height)
        points = (self._origins + depth[:, None] * self._rays)[None]
        every = np.ones(points.shape[:2], np.bool_)
        model, frames = LightModel(lights, points, every), Frames(self._values)
        try:
            model.check(every)
        except EstimateError:
            return np.full((len(depth), len(self._values)), np.nan)
        maps = StereoMaps.empty(every.shape)
        # These pixels are no neighbours, so that their differences do not show the noise.
        solve_maps(frames, model, every, None, _METHOD, maps, None, no_progress)
        samples, vectors = model.samples(frames, np.arange(len(depth)))
        normals, albedo = maps.normals[0], maps.albedo[0]
        shading = np.maximum(np.einsum("pc,pcn->pn", normals, vectors), 0)
        residuals = samples - albedo[:, None] * shading
        residuals[albedo == 0] = np.nan
        return np.asarray(residuals / self._brightness, np.float64)


def _lit(samples: Float32) -> Intp:
    """Return the number of lights that reach each pixel, from samples ``(N, P)``."""
    bright = np.nan_to_num(samples, nan=0.0, posinf=0.0, neginf=0.0)
    return np.asarray((bright > _LIT * bright.max(axis=0)).sum(axis=0), np.intp)


def _least_cost(
    cost: Callable[[float], float],
    limits: tuple[float, float],
    tried: int,
    around: tuple[float, float] | None,
    accuracy: float,
) -> float | None:
    """Return the height of least cost between two heights, by default around the best of several.

    It is None if the best is at a limit.
    """
    if around is None:
        heights = np.linspace(*limits, tried)
        best = int(np.argmin([cost(height) for height in heights]))
        if best in (0, tried - 1):
            return None
        around = heights[best - 1], heights[best + 1]
    # Imported here: it takes 0.4 s, and only near lights need it.
    from scipy.optimize import minimize_scalar

    found = minimize_scalar(cost, bounds=around, method="bounded", options={"xatol": accuracy})
    return float(found.x)
