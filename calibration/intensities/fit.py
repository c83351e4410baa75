"""Robust fit of strengths and radiation patterns, and the covariance of the result."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from calibration.intensities.blocks import Blocks
from calibration.intensities.model import Geometry, NormalEquations
from rig import short_repr
from rig.arrays import Bool, Float64

_CAUCHY = 2.385
_SHARED_ROUNDS, _OWN_ROUNDS, _LAST_ROUNDS = 8, 25, 6
# Steps below this share of the standard deviation end the iteration.
_STEADY = 0.02
_BINS = 8
_LEAST_SCALE = 1e-7
# The common mu of LEDs is rarely outside 0..3.
_MU_MEAN, _MU_WIDTH = 1.0, 2.0
# Spreads among the LEDs: their start, and the limits between which the data determine them.
_MU_SPREAD = (0.1, 0.002, 1.0)
_TILT_SPREAD = (np.radians(2.0), np.radians(0.02), np.radians(20.0))
_SHARED = 1e-4
# An LED has its own value if the data leave less than this share of the spread.
_OWN = 0.5
_FALL_ROUNDS = 10


@dataclass(eq=False)
class Fit:
    """Strengths and patterns of K lights, as far as they are fitted.

    Parameters
    ----------
    values
        ``(C, K, P)``, NaN where missing.
    geometry
        Lights and points of the blocks.
    strength
        ``(C, K)`` logarithms of the intensities.
    albedo
        ``(C, P)`` logarithms of the albedo.
    mu, tilt
        ``(K,)`` and ``(2, K)``.
    spreads
        Standard deviations among the LEDs, of mu and of a component of the tilt.
    own_mu, own_tilt
        ``(K,)`` whether a light has its own value.
    scale
        Robust standard deviation of the relative residuals.
    """

    values: Float64
    geometry: Geometry
    strength: Float64 = field(init=False)
    albedo: Float64 = field(init=False)
    mu: Float64 = field(init=False)
    tilt: Float64 = field(init=False)
    spreads: tuple[float, float] = (_SHARED, _SHARED)
    own_mu: Bool = field(init=False)
    own_tilt: Bool = field(init=False)
    scale: float = 0.0

    def __post_init__(self) -> None:
        lights = self.values.shape[1]
        self.mu, self.tilt = np.ones(lights), np.zeros((2, lights))
        self.own_mu, self.own_tilt = np.ones(lights, np.bool_), np.ones(lights, np.bool_)
        log = np.log(self.values) - self._pattern()[0]
        self.strength = np.zeros(self.values.shape[:2])
        for _ in range(3):
            self.albedo = np.nanmedian(log - self.strength[..., None], axis=1)
            self.strength = np.nanmedian(log - self.albedo[:, None], axis=2)
        self.strength -= self.strength.mean(axis=1, keepdims=True)

    def run(self) -> None:
        """Fit shared patterns, then those of each light, and share those that stay unknown."""
        self._converge(_SHARED_ROUNDS)
        self.spreads = (_MU_SPREAD[0], _TILT_SPREAD[0])
        covariance = self._converge(_OWN_ROUNDS, spreads=True)
        lights = len(self.mu)
        first = self.strength.size
        deviation = np.sqrt(np.diag(covariance)[first:]).reshape(3, lights)
        self.own_mu = deviation[0] < _OWN * self.spreads[0]
        self.own_tilt = deviation[1:].max(axis=0) < _OWN * self.spreads[1]
        self.tilt[:, ~self.own_tilt] = 0
        if not self.own_mu.all():
            self.mu[~self.own_mu] = self.mu.mean()
        self._converge(_LAST_ROUNDS)

    def _converge(self, rounds: int, *, spreads: bool = False) -> Float64:
        """Repeat steps until they are far below the standard deviations; return the covariance."""
        while True:
            rounds -= 1
            covariance, step = self._step()
            before = self.spreads
            if spreads:
                self._update_spreads(covariance)
            steady = np.allclose(before, self.spreads, rtol=0.02)
            deviations = np.sqrt(np.diag(covariance))
            if rounds == 0 or (steady and np.all(np.abs(step) <= _STEADY * deviations)):
                return covariance

    def _pattern(self) -> tuple[Float64, Float64]:
        """Return the logarithm of the model without strength and albedo, and its columns."""
        ratio, slope = self.geometry.pattern(self.tilt)
        columns = np.concatenate([ratio[None], self.mu[:, None] * slope])
        return self.geometry.fall_off + self.mu[:, None] * ratio, columns

    def residuals(self) -> tuple[Float64, Float64, Float64, Float64]:
        """Return relative residuals, weights, z = residual / scale and the columns."""
        model, columns = self._pattern()
        log = self.strength[..., None] + self.albedo[:, None] + model
        with np.errstate(over="ignore"):
            residuals = self.values / np.exp(log) - 1
        known = np.isfinite(residuals)
        residuals = np.where(known, residuals, 0.0)
        self.scale = _spread_of(residuals[known])
        scales = self._scales(residuals, known)
        z = residuals / scales
        weights = np.where(known, 1 / (1 + (z / _CAUCHY) ** 2), 0.0)
        return residuals, weights / scales**2, z, np.where(np.isfinite(columns), columns, 0.0)

    def _scales(self, residuals: Float64, known: Bool) -> Float64:
        """Return the scatter of blocks of similar brightness, but at least the median one."""
        scales = np.zeros_like(residuals)
        for c, brightness in enumerate(self.albedo):
            order = np.array_split(np.argsort(brightness), _BINS)
            found = [_spread_of(residuals[c][:, part][known[c][:, part]]) for part in order]
            least = max(float(np.median(found)), _LEAST_SCALE)
            for part, value in zip(order, found, strict=True):
                scales[c][:, part] = max(value, least)
        return scales

    def prior(self) -> tuple[Float64, Float64]:
        """Return the precision matrix of the distribution among the LEDs, and its right side."""
        channels, lights = self.strength.shape
        first = channels * lights
        precision = np.zeros((first + 3 * lights,) * 2)
        for c in range(channels):  # only ratios of strengths are determined
            own = slice(c * lights, (c + 1) * lights)
            precision[own, own] = 1e6 / lights
        mu = slice(first, first + lights)
        precision[mu, mu] = (np.eye(lights) - 1 / lights) / self.spreads[0] ** 2
        precision[mu, mu] += 1 / (lights * _MU_WIDTH) ** 2
        tilt = np.arange(first + lights, len(precision))
        precision[tilt, tilt] = 1 / self.spreads[1] ** 2
        away = np.zeros(len(precision))
        away[mu] = self.mu - _MU_MEAN
        away[tilt] = self.tilt.ravel()
        return precision, -precision @ away

    def reduction(self) -> Float64:
        """Return the matrix from the free unknowns to all of them."""
        channels, lights = self.strength.shape
        first = channels * lights
        size = first + 3 * lights
        columns = [np.eye(size)[:, :first], np.eye(size)[:, first : first + lights][:, self.own_mu]]
        if not self.own_mu.all():
            shared = np.zeros((size, 1))
            shared[first : first + lights, 0] = ~self.own_mu
            columns.append(shared)
        free = np.tile(self.own_tilt, 2)
        columns.append(np.eye(size)[:, first + lights :][:, free])
        return np.concatenate(columns, axis=1)

    def _step(self) -> tuple[Float64, Float64]:
        """Improve all unknowns once; return their approximate covariance and the step."""
        residuals, weights, z, columns = self.residuals()
        equations = NormalEquations.of(residuals, weights, columns)
        unit = efficiency(z, weights > 0)
        precision, pull = self.prior()
        free = self.reduction()
        matrix = free.T @ (equations.matrix * unit + precision) @ free
        covariance = np.linalg.inv(matrix)
        step = free @ (covariance @ (free.T @ (equations.right * unit + pull)))
        channels, lights = self.strength.shape
        first = channels * lights
        ahead = np.clip(step[:first].reshape(channels, lights), -1, 1)
        change = step[first:].reshape(3, lights)
        moved = residuals - ahead[..., None] - np.einsum("jk,jkp->kp", change, columns)
        total = weights.sum(axis=1)
        self.albedo += np.clip(
            (weights * moved).sum(axis=1) / np.where(total > 0, total, 1.0), -1, 1
        )
        self.strength += ahead
        self.mu = np.clip(self.mu + change[0], 0.0, None)
        self.tilt = np.clip(self.tilt + change[1:], -1.0, 1.0)
        return np.asarray(free @ covariance @ free.T), step

    def _update_spreads(self, covariance: Float64) -> None:
        """Estimate the spreads among the LEDs from their values (MacKay, 1992)."""
        lights = len(self.mu)
        variance = np.diag(covariance)[self.strength.size :].reshape(3, lights)
        found = []
        for values, uncertain, limits, spread, lost in (
            (self.mu - self.mu.mean(), variance[0], _MU_SPREAD, self.spreads[0], 1),
            (self.tilt.ravel(), variance[1:].ravel(), _TILT_SPREAD, self.spreads[1], 0),
        ):
            known = max(len(values) - lost - float(np.sum(uncertain)) / spread**2, 0.05)
            found.append(float(np.clip(np.sqrt(np.sum(values**2) / known), *limits[1:])))
        self.spreads = (found[0], found[1])


def efficiency(z: Float64, known: Bool) -> float:
    """Return the precision of an M-estimate relative to its summed weights (Huber, 1981)."""
    square = (z[known] / _CAUCHY) ** 2
    slope = float(np.sum((1 - square) / (1 + square) ** 2))
    score = float(np.sum((z[known] / (1 + square)) ** 2))
    weight = float(np.sum(1 / (1 + square)))
    return slope**2 / max(score * weight, 1e-300) if slope > 0 else 1.0


def slope_share(z: Float64, known: Bool) -> float:
    """Return the mean derivative of the score relative to the mean weight."""
    square = (z[known] / _CAUCHY) ** 2
    return float(np.sum((1 - square) / (1 + square) ** 2) / np.sum(1 / (1 + square)))


def covariance_of(fit: Fit, slopes: Float64, positions: Float64 | None) -> tuple[Float64, Float64]:
    """Return the covariance of strengths, mu and tilts, `NormalEquations` explains the order.

    The second result is their derivatives by the positions, ``(n, 3, K)`` per mm.

    It is the sandwich estimate with the block as its unit, plus the distribution among the LEDs,
    plus the propagated covariances of the positions.

    Parameters
    ----------
    fit
        A fit that has run.
    slopes
        ``(3, K, P)`` derivatives by the positions.
    positions
        ``(K, 3, 3)`` covariances in mm^2; None if they are not known.
    """
    residuals, weights, z, columns = fit.residuals()
    slopes = np.where(np.isfinite(slopes), slopes, 0.0)
    equations = NormalEquations.of(
        residuals, weights, np.concatenate([columns, slopes]), scores=True
    )
    scores = equations.scores
    lights = len(fit.mu)
    size = fit.strength.size + 3 * lights
    share = max(slope_share(z, weights > 0), 0.1)
    precision, _ = fit.prior()
    free = fit.reduction()
    matrix = free.T @ (equations.matrix[:size, :size] * share + precision) @ free
    inverse = free @ np.linalg.inv(matrix) @ free.T
    spread = scores[:size] @ scores[:size].T if scores is not None else equations.matrix
    covariance = inverse @ (spread + precision) @ inverse
    shared = np.concatenate([~fit.own_mu, np.tile(~fit.own_tilt, 2)])
    variance = np.repeat(np.square(fit.spreads), (lights, 2 * lights)) * shared
    cross = equations.matrix * share
    if shared.any():
        place = fit.strength.size + np.flatnonzero(shared)
        gain = -inverse @ cross[:size, place]
        gain[place, np.arange(len(place))] += 1
        covariance = covariance + (gain * variance[shared]) @ gain.T
    by_positions = (-inverse @ cross[:size, size:]).reshape(size, 3, lights)
    if positions is not None:
        for k in range(lights):
            if np.isfinite(positions[k]).all():
                gain = by_positions[:, :, k]
                covariance = covariance + gain @ positions[k] @ gain.T
    return np.asarray(covariance), by_positions


def _spread_of(residuals: Float64) -> float:
    """Return the robust standard deviation of values around 0."""
    return 1.4826 * float(np.median(np.abs(residuals))) if residuals.size else 0.0


@dataclass(frozen=True)
class Vignetting:
    """Brightness of an evenly lit image, ``1 + a r^2 + b r^4`` in its logarithm.

    Parameters
    ----------
    coefficients
        a and b, where r is the distance from the middle of the image relative to its corner.
    corner
        Brightness of a corner relative to the middle; 1 without vignetting.
    corner_std
        Standard deviation of `corner`.
    """

    coefficients: tuple[float, float]
    corner: float
    corner_std: float

    __repr__ = short_repr


def fit_vignetting(fit: Fit, blocks: Blocks, covariance: Float64) -> Vignetting:
    """Fit a radial fall to the albedo of surfaces of even albedo.

    Linear gradients are fitted as well and left out, because the tilts of all lights together
    look like one.

    Parameters
    ----------
    fit
        A fit that has run; the mean over its channels is used.
    blocks
        The blocks it was fitted to.
    covariance
        Of its unknowns.
    """
    _, weights, _, columns = fit.residuals()
    surfaces = blocks.part[:, None] == np.unique(blocks.part)
    size = np.ptp(blocks.points_mm[:, :2], axis=0).max()
    design = np.concatenate(
        [
            np.stack([blocks.radius**2, blocks.radius**4], axis=1),
            blocks.points_mm[:, :2] / size,
            surfaces,
        ],
        axis=1,
    )
    albedo = fit.albedo.mean(axis=0)
    robust = np.ones(len(albedo))
    for _ in range(_FALL_ROUNDS):
        inverse = np.linalg.pinv((design * robust[:, None]).T @ design)
        found = inverse @ (design.T @ (robust * albedo))
        rest = albedo - design @ found
        scale = max(1.4826 * float(np.median(np.abs(rest))), 1e-9)
        robust = 1 / (1 + (rest / (2.385 * scale)) ** 2)
    gain = inverse @ (design * robust[:, None]).T
    noise = (gain * rest**2) @ gain.T
    shift = shift_by_lights(fit, weights, columns, gain)
    total = noise + shift @ covariance @ shift.T
    fall = float(found[0] + found[1])
    deviation = float(np.sqrt(total[:2, :2].sum()))
    corner = float(np.exp(fall))
    return Vignetting((float(found[0]), float(found[1])), corner, corner * deviation)


def shift_by_lights(fit: Fit, weights: Float64, columns: Float64, gain: Float64) -> Float64:
    """Return the derivatives of linear figures of the albedo by the unknowns of the lights.

    An error of the lights changes the logarithm of the albedo by the weighted mean of the columns,
    negated.

    Parameters
    ----------
    fit
        A fit that has run.
    weights, columns
        As `Fit.residuals` returns them.
    gain
        ``(F, P)`` derivatives of F figures by the mean logarithm of the albedo over the channels.

    Returns
    -------
    NDArray
        ``(F, n)`` for the n unknowns in the order of `NormalEquations`.
    """
    channels, lights = fit.strength.shape
    shift = np.zeros((len(gain), (channels + len(columns)) * lights))
    for c in range(channels):
        share = weights[c] / np.maximum(weights[c].sum(axis=0), 1e-300) / channels
        shift[:, c * lights : (c + 1) * lights] = -gain @ share.T
        for j, column in enumerate(columns):
            place = slice((channels + j) * lights, (channels + j + 1) * lights)
            shift[:, place] -= gain @ (share * column).T
    return shift
