"""Fit of parameters that all images of a series share, with normals and albedo of every cell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calibration import EstimateError
from processing.images.coarse_images import coarse_images
from processing.images.recorded_images import Images
from processing.images.viewing_rays import View
from rig.arrays import Bool, Float64, Intp

# Cells that show the parameters, about, and the fewest of them.
CELLS = 800
_FEWEST_CELLS = 60
# Darker samples, relative to the brightest of their cell, are probably in shadow.
_DARK = 0.1
_FEWEST_LIT = 5
# Residuals count less from this many standard deviations on (Cauchy).
_TUNING = 2.0
# Exponents of the lobes of a gloss, which with two terms of a rough surface are nuisances, and the
# width of the prior of their strengths, relative to the albedo.
_LOBES = (2, 8, 32, 128)
_REFLECTANCES = len(_LOBES) + 2
_REFLECTANCE_WIDTH = 0.5
# Residuals of neighbouring cells are alike: scores are added up in so many tiles per axis.
_TILES = 8
# Smallest cosine by which a term of the reflectance is divided; cells that are steeper show no
# shape.
_GRAZING = 0.05
# Keeps cells without enough light solvable.
_RIDGE = 1e-6
_OUTERMOST = 0.01
_MOST_STEPS = 12
_MOST_DAMPING = 1e3
# A fit ends when the parameters change by less than this part of their standard deviations.
_SETTLED = 0.05


@dataclass(frozen=True, eq=False)
class Parameter:
    """A parameter that is fitted.

    Parameters
    ----------
    start, width
        Mean and standard deviation of the prior; infinite without one.
    step
        For differences.
    lowest, highest
        Its bounds.
    """

    start: float
    width: float
    step: float
    lowest: float = -np.inf
    highest: float = np.inf


@dataclass(frozen=True, eq=False)
class SharedModel:
    """Light vectors that depend on parameters, and terms that are added to the images.

    Parameters
    ----------
    parameters
        Of the vectors; the coefficients of the added terms follow.
    vectors
        Return light vectors ``(P, N, 3)`` at points ``(P, 3)`` from the values of the parameters.
    points
        Return points ``(P, 3)`` from the values of the parameters and the points of a surface of
        mean height 0.
    added
        Priors of the coefficients of further added terms.
    terms
        Return such terms ``(P, 1, A)`` relative to the albedo, from unit normals ``(P, 3)``.
    """

    parameters: tuple[Parameter, ...]
    vectors: Callable[[Float64, Float64], Float64]
    points: Callable[[Float64, Float64], Float64]
    added: tuple[Parameter, ...] = ()
    terms: Callable[[Float64], Float64] = lambda normals: np.zeros((len(normals), 1, 0))


@dataclass(frozen=True, eq=False)
class SeriesFit:
    """Parameters with their errors.

    Parameters
    ----------
    values
        ``(Q,)`` the parameters of `SharedModel`, without those of the reflectance.
    covariance
        ``(Q, Q)`` from the scatter between parts of the object, or by the number of independent
        residuals if that is larger.
    spread
        Standard deviation of the residuals relative to the brightness of their cell, robust.
    relief_mm
        Range of the heights of the surface, without the outermost hundredth.
    """

    values: Float64
    covariance: Float64
    spread: float
    relief_mm: float


@dataclass(frozen=True, eq=False)
class _State:
    """A solution: parameters, scaled normals, points, and the residuals under weights."""

    values: Float64
    scaled: Float64
    points: Float64
    vectors: Float64
    inverse: Float64
    residuals: Float64
    weights: Float64
    cost: float = np.inf


class SeriesCells:
    """Cells of the images, and fits of shared parameters to them.

    A cell has its own normal and albedo, which are eliminated. The reflectance, one for the
    object, is fitted with every model: lobes of a gloss, and terms of a rough surface.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear radiance, NaN where saturated.
    mask
        ``(H, W)`` bool, the object.
    view
        How the pixels see the surface.

    Raises
    ------
    EstimateError
        If too few cells are lit by 5 lights.
    """

    def __init__(self, values: Images, mask: Bool, view: View) -> None:
        coarse = coarse_images(values, mask, view, CELLS)
        flat = coarse.values.reshape(len(values), -1).T.astype(np.float64)
        with np.errstate(invalid="ignore"):
            brightest = np.nanmax(np.where(coarse.mask.reshape(-1, 1), flat, 0.0), axis=1)
            usable = np.isfinite(flat) & (flat > _DARK * brightest[:, None])
        enough = coarse.mask.reshape(-1) & (usable.sum(axis=1) >= _FEWEST_LIT)
        self.places: Intp = np.flatnonzero(enough)
        if len(self.places) < _FEWEST_CELLS:
            raise EstimateError(
                f"only {len(self.places)} blocks of the object are lit by {_FEWEST_LIT} lights: "
                f"at least {_FEWEST_CELLS} are required"
            )
        self.usable = usable[self.places]
        seen = np.where(self.usable, flat[self.places], 0.0)
        self.brightness = np.sqrt((seen**2).sum(axis=1) / self.usable.sum(axis=1))
        self.values = seen / self.brightness[:, None]
        self.shape, self.factor, self._view = coarse.mask.shape, coarse.factor, coarse.view
        self._origins, self.rays = (
            of.reshape(-1, 3)[self.places] for of in (coarse.origins, coarse.rays)
        )
        self.flat_points = self._origins + self._view.distance_mm * self.rays
        toward = -self.rays / np.linalg.norm(self.rays, axis=1)[:, None]
        self._toward = toward
        rows, columns = np.divmod(self.places, self.shape[1])
        tiles = [(at - at.min()) * _TILES // (int(np.ptp(at)) + 1) for at in (rows, columns)]
        self._tiles = tiles[0] * _TILES + tiles[1]
        self._surface = _Surface(self.flat_points, self.rays, self.places, self.shape)
        across = self.flat_points - self.flat_points.mean(axis=0)
        self.radius_mm = float(np.quantile(np.linalg.norm(across, axis=1), 0.95))

    def best(self, model: SharedModel, starts: list[Float64]) -> SeriesFit:
        """Fit a model from the best of several starts, values of its first parameters."""
        own, fits = self._parameters(model), []
        held = np.arange(len(own)) > 0
        for start in starts:
            first = np.array([one.start for one in own])
            first[: len(start)] = start
            free = held if len(starts) > 1 else np.ones_like(held)
            fits.append(self._fitted(model, first, free, 2))
        spread, state = min(fits, key=lambda fit: fit[0])
        spread, state = self._fitted(model, state.values, np.ones_like(held), _MOST_STEPS, state)
        return self._result(model, state, spread)

    def _parameters(self, model: SharedModel) -> list[Parameter]:
        reflectance = [Parameter(0.0, _REFLECTANCE_WIDTH, 0.01)] * _REFLECTANCES
        return [*model.parameters, *model.added, *reflectance]

    def _fitted(
        self,
        model: SharedModel,
        values: Float64,
        free: Bool,
        steps: int,
        state: _State | None = None,
    ) -> tuple[float, _State]:
        """Return the spread of the residuals and the solution, by damped Gauss-Newton steps."""
        state = self._start(model, values) if state is None else state
        state = self._solved(model, values, state, None)
        spread, damping = self._spread(state), 1e-3
        state = self._solved(model, values, state, spread)
        own = self._parameters(model)
        bounds = np.array([(one.lowest, one.highest) for one in own]).T
        mean, width = (np.array([getattr(one, name) for one in own]) for name in ("start", "width"))
        for _ in range(steps):
            normal, scores, effect = self._system(model, state, spread)
            prior = spread**2 * effect / width**2
            state = replace(state, cost=self._cost(state, spread, prior, mean))
            slope = scores.sum(axis=0) - prior * (state.values - mean)
            hessian = normal + np.diag(prior)
            known = np.sqrt(np.diag(hessian)) / (spread * np.sqrt(effect))
            while damping < _MOST_DAMPING:
                damped = hessian + damping * np.diag(np.diag(normal) + 1e-12)
                change = _bounded(damped, slope, state.values, bounds, free)
                tried = self._solved(model, state.values + change, state, spread)
                tried = replace(tried, cost=self._cost(tried, spread, prior, mean))
                if tried.cost < state.cost:
                    state, damping = tried, max(damping / 10, 1e-6)
                    break
                damping *= 10
            else:
                break
            if np.max(np.abs(change) * known) < _SETTLED:
                break
            spread = self._spread(state)
        return spread, state

    def _result(self, model: SharedModel, state: _State, spread: float) -> SeriesFit:
        normal, scores, effect = self._system(model, state, spread)
        width = np.array([one.width for one in self._parameters(model)])
        inverse = np.linalg.inv(normal + np.diag(spread**2 * effect / width**2))
        tiles = len(np.unique(self._tiles))
        scatter = scores - scores.mean(axis=0)
        between = inverse @ (scatter.T @ scatter * tiles / max(tiles - 1, 1)) @ inverse
        within = inverse * spread**2 * effect
        larger = np.sqrt(np.maximum(np.diag(between) / np.diag(within), 1.0))
        count = len(model.parameters) + len(model.added)
        covariance = (within * np.outer(larger, larger))[:count, :count]
        depths = self._surface.depths(state.scaled)
        relief = float(np.ptp(np.quantile(depths, [_OUTERMOST / 2, 1 - _OUTERMOST / 2])))
        return SeriesFit(state.values[:count], covariance, spread, relief)

    def _start(self, model: SharedModel, values: Float64) -> _State:
        count, lights = self.values.shape
        return _State(
            values,
            np.zeros((count, 3)),
            self.flat_points,
            np.zeros((count, lights, 3)),
            np.zeros((count, 3, 3)),
            np.zeros((count, lights)),
            self.usable.astype(np.float64),
        )

    def _spread(self, state: _State) -> float:
        return max(1.4826 * float(np.median(np.abs(state.residuals[self.usable]))), 1e-6)

    def _solved(
        self, model: SharedModel, values: Float64, near: _State, spread: float | None
    ) -> _State:
        """Return normals, albedo and points for parameters; normals and points in turn."""
        state = near
        for _ in range(2):
            points = self._relief(state.scaled) if state.scaled.any() else self.flat_points
            state = self._normals(model, values, replace(state, points=points), spread)
        return state

    def _normals(
        self,
        model: SharedModel,
        values: Float64,
        near: _State,
        spread: float | None,
        *,
        held: bool = False,
    ) -> _State:
        """Return robust normals and albedo at points; the weights may be held."""
        vectors = model.vectors(values, model.points(values, near.points))
        scaled, weights, residuals = near.scaled, near.weights, near.residuals
        for _ in range(2):
            wanted = self.values
            if scaled.any():
                terms = self._terms(model, scaled, vectors)
                wanted = wanted - terms @ values[len(model.parameters) :]
            weighted = (vectors * weights[..., None]).transpose(0, 2, 1)
            matrix = weighted @ vectors + _RIDGE * np.eye(3)
            inverse = np.asarray(np.linalg.inv(matrix), np.float64)
            scaled = np.asarray((inverse @ (weighted @ wanted[..., None]))[..., 0], np.float64)
            residuals = np.asarray(wanted - (vectors @ scaled[..., None])[..., 0], np.float64)
            if held:
                continue
            found = replace(near, residuals=residuals)
            limit = _TUNING * (self._spread(found) if spread is None else spread)
            weights = np.where(self.usable, 1 / (1 + (residuals / limit) ** 2), 0.0)
        return _State(values, scaled, near.points, vectors, inverse, residuals, weights)

    def _terms(self, model: SharedModel, scaled: Float64, vectors: Float64) -> Float64:
        """Return the terms ``(P, N, A)`` that are added: of the model, then of the reflectance."""
        albedo = np.maximum(np.linalg.norm(scaled, axis=1), 1e-9)
        normals = (scaled / albedo[:, None])[..., None]
        lit = np.maximum((vectors @ normals)[..., 0], 0)
        unit = vectors / np.maximum(np.linalg.norm(vectors, axis=2), 1e-9)[..., None]
        cosine = np.maximum((unit @ normals)[..., 0], 0)
        toward = self._toward[..., None]
        seen = np.maximum((self._toward[:, None] @ normals)[:, 0], _GRAZING)
        between = (unit @ toward)[..., 0]
        # The half vector is the sum of two unit vectors, of this length.
        half = np.sqrt(np.maximum(2 + 2 * between, _GRAZING))
        gloss = np.minimum((cosine + seen) / half, 1.0)
        # Oren and Nayar, 1994: light comes back to where it comes from.
        back = np.maximum(between - cosine * seen, 0)
        rough = lit * back / np.maximum(np.maximum(cosine, seen), _GRAZING)
        reflectance = np.stack([*(lit * gloss**k for k in _LOBES), rough, lit * cosine], axis=2)
        own = model.terms(normals[..., 0])
        own = np.broadcast_to(own, (*lit.shape, own.shape[2]))
        terms = np.concatenate([own, reflectance], axis=2) * albedo[:, None, None]
        return np.asarray(terms, np.float64)

    def _relief(self, scaled: Float64) -> Float64:
        """Return the points of the surface of the normals at the mean height 0."""
        depths = self._surface.depths(scaled)
        return np.asarray(self.flat_points + depths[:, None] * self.rays, np.float64)

    def _cost(self, state: _State, spread: float, prior: Float64, mean: Float64) -> float:
        ratio = state.residuals[self.usable] / (_TUNING * spread)
        cost = (_TUNING * spread) ** 2 * np.log1p(ratio**2).sum()
        return float(cost + (prior * (state.values - mean) ** 2).sum()) / 2

    def _system(
        self, model: SharedModel, state: _State, spread: float
    ) -> tuple[Float64, Float64, float]:
        """Return normal matrix, scores of tiles, and the design effect, without the normals."""
        held = self._moved(model, state, state.values)
        columns = np.zeros((*self.values.shape, len(state.values)))
        for k, one in enumerate(self._parameters(model)):
            values = state.values.copy()
            values[k] += one.step if values[k] + one.step <= one.highest else -one.step
            step = values[k] - state.values[k]
            columns[..., k] = (held - self._moved(model, state, values)) / step
        weights = state.weights[..., None]
        count = columns.shape[2]
        normal = (columns * weights).reshape(-1, count).T @ columns.reshape(-1, count)
        scores = (columns.transpose(0, 2, 1) @ (weights * state.residuals[..., None]))[..., 0]
        of_tiles = np.zeros((_TILES**2, count))
        np.add.at(of_tiles, self._tiles, scores)
        expected = spread**2 * np.maximum(np.diag(normal), 1e-30)
        effect = float(np.median((of_tiles**2).sum(axis=0) / expected))
        return normal, of_tiles[np.unique(self._tiles)], max(effect, 1.0)

    def _moved(self, model: SharedModel, state: _State, values: Float64) -> Float64:
        """Return the residuals at other values, where normals and surface follow."""
        for _ in range(2):
            points = self._relief(state.scaled)
            state = self._normals(model, values, replace(state, points=points), None, held=True)
        return state.residuals


class _Surface:
    """Depths of cells from their normals: the least squares over differences of neighbours."""

    def __init__(
        self, points: Float64, rays: Float64, places: Intp, shape: tuple[int, ...]
    ) -> None:
        # Imported here: they take .2 s.
        from scipy.sparse import csr_array, eye_array
        from scipy.sparse.linalg import splu

        number = np.full(shape, -1)
        number.flat[places] = np.arange(len(places))
        pairs = [
            np.stack([first.ravel(), second.ravel()])
            for first, second in (
                (number[:, :-1], number[:, 1:]), (number[:-1], number[1:])
            )
        ]  # fmt: skip
        joined = np.concatenate(pairs, axis=1)
        self._pairs = joined[:, (joined >= 0).all(axis=0)]
        count = self._pairs.shape[1]
        rows = np.tile(np.arange(count), 2)
        signs = np.repeat([-1.0, 1.0], count)
        self._differences = csr_array(
            (signs, (rows, self._pairs.ravel())), shape=(count, len(places))
        )
        matrix = self._differences.T @ self._differences + _RIDGE * eye_array(len(places))
        self._solve = splu(matrix.tocsc()).solve
        self._across = points[self._pairs[1]] - points[self._pairs[0]]
        self._rays = rays

    def depths(self, scaled: Float64) -> Float64:
        """Return depths ``(P,)`` along the rays, relative to the flat points, with the mean 0."""
        unit = scaled / np.maximum(np.linalg.norm(scaled, axis=1), 1e-9)[:, None]
        between = unit[self._pairs].sum(axis=0)
        rays = self._rays[self._pairs].sum(axis=0) / 2
        along = np.minimum(np.einsum("pc,pc->p", between, rays), -2 * _GRAZING)
        steps = -np.einsum("pc,pc->p", between, self._across) / along
        depth = self._solve(self._differences.T @ steps)
        return np.asarray(depth - depth.mean(), np.float64)


def _bounded(
    matrix: Float64, slope: Float64, values: Float64, bounds: Float64, free: Bool
) -> Float64:
    """Return the step of a quadratic function; a parameter that would leave its bounds is there."""
    change, free = np.zeros_like(values), free.copy()
    while True:
        at = np.flatnonzero(free)
        right = slope[at] - matrix[np.ix_(at, np.flatnonzero(~free))] @ change[~free]
        change[at] = np.linalg.solve(matrix[np.ix_(at, at)], right)
        reached = values + change
        outside = free & ((reached < bounds[0]) | (reached > bounds[1]))
        if not outside.any():
            return change
        change[outside] = np.clip(reached, *bounds)[outside] - values[outside]
        free &= ~outside
