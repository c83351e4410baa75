"""Fit of parameters that all images of a series share, with normals and albedo of every cell."""

from __future__ import annotations

import math
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
# Roughness of the lobes of a gloss, which with three terms of a rough surface are nuisances; share
# of the light that a lacquer mirrors.
_LOBES = (0.12, 0.2, 0.33, 0.55)
_LACQUER = 0.04
# Widths of the priors of their strengths, relative to a typical albedo, and to that of the cell.
_GLOSS_WIDTH, _ROUGH_WIDTH = 2.0, 0.5
# Residuals of neighbouring cells are alike: scores are added up in so many tiles per axis.
_TILES = 8
# Smallest cosine by which a term of the reflectance is divided; cells that are steeper show no
# shape.
_GRAZING = 0.05
# Keeps cells without enough light solvable.
_RIDGE = 1e-6
_OUTERMOST = 0.01
_TURNS = 3
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
    rays
        Return rays ``(P, 3)`` along which the cells see the surface, per unit of depth, from the
        values of the parameters.
    mean_depth
        Return the mean depth of the surface along them, relative to the flat points, from the
        values of the parameters.
    added
        Priors of the coefficients of further added terms.
    terms
        Return such terms ``(P, 1, A)`` relative to the albedo, from unit normals ``(P, 3)``.
    """

    parameters: tuple[Parameter, ...]
    vectors: Callable[[Float64, Float64], Float64]
    rays: Callable[[Float64], Float64]
    mean_depth: Callable[[Float64], float]
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
    reflectance
        Root mean square of what the fitted reflectance adds to a matte surface, relative to the
        brightness, without what other normals would explain.
    """

    values: Float64
    covariance: Float64
    spread: float
    relief_mm: float
    reflectance: float


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
    """Pixels all over the object, cells, and fits of shared parameters to them.

    Cells are as small as images are sharp: averages over relief would not show its reflectance. A
    cell has its own normal and albedo, which are eliminated. The reflectance, one for the
    object, is fitted with every model: lobes of a gloss, terms of a rough
    surface, and what a lacquer mirrors.

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
        coarse = coarse_images(values, mask, view)
        step = max(1, math.isqrt(int(np.count_nonzero(coarse.mask)) // CELLS))
        some = slice(step // 2, None, step), slice(step // 2, None, step)
        inside = coarse.mask[some]
        flat = coarse.values[:, *some].reshape(len(values), -1).T.astype(np.float64)
        with np.errstate(invalid="ignore"):
            brightest = np.nanmax(np.where(inside.reshape(-1, 1), flat, 0.0), axis=1)
            usable = np.isfinite(flat) & (flat > _DARK * brightest[:, None])
        enough = inside.reshape(-1) & (usable.sum(axis=1) >= _FEWEST_LIT)
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
        self._typical = np.median(self.brightness) / self.brightness
        origins, self.rays = (
            of[some].reshape(-1, 3)[self.places] for of in (coarse.origins, coarse.rays)
        )
        self.flat_points = origins + coarse.view.distance_mm * self.rays
        rows, columns = np.divmod(self.places, inside.shape[1])
        tiles = [(at - at.min()) * _TILES // (int(np.ptp(at)) + 1) for at in (rows, columns)]
        self._tiles = tiles[0] * _TILES + tiles[1]
        self._surface = _Surface(self.flat_points, self.places, inside.shape)
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
        gloss = [Parameter(0.0, _GLOSS_WIDTH, 0.01)] * len(_LOBES)
        rough = [Parameter(0.0, _ROUGH_WIDTH, 0.01)] * 3
        return [*model.parameters, *model.added, *gloss, *rough]

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
        values, mean = state.values, model.mean_depth(state.values)
        depths = self._surface.depths(state.scaled, model.rays(values), mean)
        relief = float(np.ptp(np.quantile(depths, [_OUTERMOST / 2, 1 - _OUTERMOST / 2])))
        terms = self._added(model, values, state.scaled, state.vectors)[..., len(model.added) :]
        added = terms @ values[count:]
        weighted = (state.vectors * state.weights[..., None]).transpose(0, 2, 1)
        normals = state.inverse @ (weighted @ added[..., None])
        left = (added - (state.vectors @ normals)[..., 0])[self.usable]
        of_gloss = float(np.sqrt(np.mean(left**2)))
        return SeriesFit(values[:count], covariance, spread, relief, of_gloss)

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
            points = self._points(model, values, state.scaled)
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
        vectors = model.vectors(values, near.points)
        scaled, weights, residuals = near.scaled, near.weights, near.residuals
        for _ in range(2):
            wanted = self.values
            if scaled.any():
                terms = self._added(model, values, scaled, vectors)
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

    def _added(
        self, model: SharedModel, values: Float64, scaled: Float64, vectors: Float64
    ) -> Float64:
        rays = model.rays(values)
        toward = -rays / np.linalg.norm(rays, axis=1)[:, None]
        return _terms(model, scaled, vectors, toward, self._typical)

    def _points(self, model: SharedModel, values: Float64, scaled: Float64) -> Float64:
        """Return the points of the surface of the normals; of a flat one before these are known."""
        rays, mean = model.rays(values), model.mean_depth(values)
        depths = np.full(len(scaled), mean)
        if scaled.any():
            depths = self._surface.depths(scaled, rays, mean)
        return np.asarray(self.flat_points + depths[:, None] * rays, np.float64)

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
            points = self._points(model, values, state.scaled)
            state = self._normals(model, values, replace(state, points=points), None, held=True)
        return state.residuals


def _terms(
    model: SharedModel, scaled: Float64, vectors: Float64, toward: Float64, typical: Float64
) -> Float64:
    """Return the terms ``(P, N, A)`` that are added: of the model, then of the reflectance.

    A gloss is as bright on dark paint as on bright paint; ``typical`` is a typical brightness
    relative to that of the cells.
    """
    albedo = np.maximum(np.linalg.norm(scaled, axis=1), 1e-9)
    normals = (scaled / albedo[:, None])[..., None]
    lit = np.maximum((vectors @ normals)[..., 0], 0)
    unit = vectors / np.maximum(np.linalg.norm(vectors, axis=2), 1e-9)[..., None]
    cosine = np.maximum((unit @ normals)[..., 0], 0)
    seen = np.maximum(toward[:, None] @ normals, _GRAZING)[:, 0]
    between = (unit @ toward[..., None])[..., 0]
    gloss = [lit * _gloss(cosine, seen, between, width) for width in _LOBES]
    # Oren and Nayar, 1994: light comes back to where it comes from.
    back = np.maximum(between - cosine * seen, 0)
    rough = lit * back / np.maximum(np.maximum(cosine, seen), _GRAZING)
    # What a lacquer mirrors does not reach the paint (Schlick).
    mirrored = (1 - np.minimum(cosine, 1)) ** 5 + (1 - np.minimum(seen, 1)) ** 5
    own = model.terms(normals[..., 0])
    own = np.broadcast_to(own, (*lit.shape, own.shape[2]))
    painted = [*np.moveaxis(own, 2, 0), rough, lit * cosine, lit * mirrored]
    count = own.shape[2]
    terms = [*painted[:count], *gloss, *painted[count:]]
    scales = [albedo] * count + [typical] * len(gloss) + [albedo] * 3
    return np.stack(
        [term * scale[:, None] for term, scale in zip(terms, scales, strict=True)], axis=2
    )


def _gloss(cosine: Float64, seen: Float64, between: Float64, width: float) -> Float64:
    """Return the reflectance of a lacquer relative to what it mirrors, from cosines.

    Walter et al., 2007, with masking by Heitz, 2014, and the term of Schlick for its edge.
    """
    square = width**2
    # The half vector is the sum of two unit vectors, of this length.
    half = np.sqrt(np.maximum(2 + 2 * between, _GRAZING))
    dip = np.minimum((cosine + seen) / half, 1.0) ** 2 * (square - 1) + 1
    masked = cosine * np.sqrt(seen**2 * (1 - square) + square)
    masked += seen * np.sqrt(cosine**2 * (1 - square) + square)
    edge = 1 + (1 / _LACQUER - 1) * (1 - np.minimum(half / 2, 1)) ** 5
    return np.asarray(_LACQUER * edge * square / dip**2 * 0.5 / masked, np.float64)


class _Surface:
    """Depths of cells from their normals: the least squares over differences of neighbours."""

    def __init__(self, points: Float64, places: Intp, shape: tuple[int, ...]) -> None:
        # Imported here: they take 0.2 s.
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

    def depths(self, scaled: Float64, rays: Float64, mean: float) -> Float64:
        """Return depths ``(P,)`` along rays, relative to the flat points, with a mean."""
        unit = scaled / np.maximum(np.linalg.norm(scaled, axis=1), 1e-9)[:, None]
        between = unit[self._pairs].sum(axis=0)
        first, second = rays[self._pairs]
        along = np.einsum("pc,pc->p", between, (first + second) / 2)
        along = np.minimum(along, -2 * _GRAZING)
        depth = np.full(len(scaled), mean)
        for _ in range(_TURNS):  # points are further apart where they are deeper
            deep = depth[self._pairs].mean(axis=0)[:, None]
            apart = self._across + deep * (second - first)
            steps = -np.einsum("pc,pc->p", between, apart) / along
            depth = self._solve(self._differences.T @ steps)
            depth += mean - depth.mean()
        return np.asarray(depth, np.float64)


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
