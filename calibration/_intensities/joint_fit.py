"""Fit of strengths, patterns and positions together: the positions have priors."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.stats import chi2

from acquisition import Lights, tangent_basis
from calibration._intensities.blocks import Blocks
from calibration._intensities.fit import Fit, covariance_of
from calibration._intensities.model import Geometry, position_slopes
from calibration._intensities.surface import Array

# A card that is thicker than assumed looks like lights that are all lower.
_HEIGHT_MM = 1.0
# Positions that were given as exact are known to this.
_FINEST_MM = 1e-3
# Shifts beyond this quantile of their distribution enlarge the covariances, and an enlargement by
# more than this means that positions or surface are wrong.
_QUANTILE = 0.999
_ENLARGED = 3
_WRONG = 25.0
_LEAST_KNOWN = 0.05
_ROUNDS = 25


@dataclass(eq=False, kw_only=True)
class JointFit(Fit):
    """A fit with the positions of K lights relative to the surface as further unknowns.

    The positions have a normal distribution around those given, with their covariances, plus an
    error of the height of the surface that all share. So the maximum of the posterior probability
    is found.

    Parameters
    ----------
    lights
        Lights with the given positions, and axes.
    blocks
        What they light.
    covariances
        ``(K, 3, 3)`` of the given positions in mm^2.
    shift
        ``(3, K)`` changes of the positions relative to the surface, in mm.
    enlarged
        Factor by which `covariances` were enlarged.
    """

    lights: Lights
    blocks: Blocks
    covariances: Array
    shift: Array = field(init=False)
    enlarged: float = 1.0

    @classmethod
    def of(cls, fit: Fit, lights: Lights, blocks: Blocks, covariances: Array) -> JointFit:
        """Return the continuation of a fit that has run with fixed positions."""
        axes = np.asarray(lights.axes)  # they stay parallel
        found = cls(
            fit.values,
            fit.geometry,
            lights=replace(lights, axes=axes),
            blocks=blocks,
            covariances=covariances + _FINEST_MM**2 * np.eye(3),
        )
        found.strength, found.albedo = fit.strength.copy(), fit.albedo.copy()
        found.mu, found.tilt, found.spreads = fit.mu.copy(), fit.tilt.copy(), fit.spreads
        found.own_mu, found.own_tilt = fit.own_mu, fit.own_tilt
        return found

    def __post_init__(self) -> None:
        self.shift = np.zeros((3, len(self.lights)))
        super().__post_init__()

    def run(self) -> None:
        """Fit strengths, patterns and positions of each light.

        If the positions move by more than their covariances admit, these are enlarged. It stays the
        same which lights have their own patterns.
        """
        for _ in range(_ENLARGED):
            self.converge(_ROUNDS, spreads=True)
            excess = self._excess(covariance_of(self))
            if excess == 1.0:
                return
            self.enlarged *= excess
            self.covariances = excess * self.covariances
        self.converge(_ROUNDS, spreads=True)

    @property
    def contradicted(self) -> bool:
        """Whether the given covariances are far too small."""
        return self.enlarged > _WRONG

    def _excess(self, covariance: Array) -> float:
        """Return the reduced chi-square of the shifts if it is significant, else 1.

        Shifts have the variance that the surface takes away from the prior, in the directions in
        which it takes any.
        """
        prior = self._spread()
        left = covariance[-len(prior) :, -len(prior) :]
        half = np.linalg.cholesky(prior)
        whitened = np.linalg.solve(half, np.linalg.solve(half, prior - left).T)
        values, vectors = np.linalg.eigh(0.5 * (whitened + whitened.T))
        known = values > _LEAST_KNOWN
        size = vectors[:, known].T @ np.linalg.solve(half, self.shift.ravel())
        square, freedom = float(np.sum(size**2 / values[known])), int(known.sum())
        return square / freedom if square > chi2.ppf(_QUANTILE, max(freedom, 1)) else 1.0

    def placed(self, covariance: Array) -> tuple[Lights, Array]:
        """Return the lights at their new positions, and the covariances ``(K, 3, 3)``.

        The surface shows positions relative to itself. Their changes are divided between positions
        and height of the surface in proportion to the priors.

        Parameters
        ----------
        covariance
            Covariance of all unknowns.
        """
        lights = len(self.lights)
        own, shown = self._own(), covariance[-3 * lights :, -3 * lights :]
        gain = np.linalg.solve(self._spread(), own).T
        shift = (gain @ self.shift.ravel()).reshape(3, lights)
        left = own - gain @ own + gain @ shown @ gain.T
        blocks = left.reshape(3, lights, 3, lights)
        found = np.einsum("akbk->kab", blocks)
        positions = np.asarray(self.lights.positions_mm) + shift.T
        return replace(self.lights, positions_mm=positions), 0.5 * (
            found + np.moveaxis(found, 1, 2)
        )

    def prior(self) -> tuple[Array, Array]:
        """Return the precision matrix of all unknowns, and its right side."""
        precision, right = super().prior()
        of_shift = np.linalg.inv(self._spread())
        pull = -of_shift @ self.shift.ravel()
        return block_diag(precision, of_shift), np.concatenate([right, pull])

    def reduction(self) -> Array:
        """Return the matrix from the free unknowns to all of them."""
        return np.asarray(block_diag(super().reduction(), np.eye(self.shift.size)), np.float64)

    def pattern(self) -> tuple[Array, Array]:
        """Return the logarithm of the model without strength and albedo, and its columns."""
        positions = np.asarray(self.lights.positions_mm) + self.shift.T
        lights = replace(self.lights, positions_mm=positions)
        points, normals = self.blocks.points_mm, self.blocks.normals
        self.geometry = Geometry.of(lights, points, normals)
        model, columns = super().pattern()
        axes = np.asarray(lights.axes)
        turned = axes + np.einsum("jk,kji->ki", self.tilt, tangent_basis(axes))
        slopes = position_slopes(replace(lights, axes=turned, mu=self.mu), points, normals)
        return model, np.concatenate([columns, slopes])

    def move(self, change: Array) -> None:
        """Add a step ``(6, K)`` to mu, tilts and positions."""
        super().move(change[:3])
        self.shift = self.shift + change[3:]

    def _own(self) -> Array:
        """Return the covariance ``(3 K, 3 K)`` of the given positions, x of all lights first."""
        lights = len(self.lights)
        spread = np.zeros((3, lights, 3, lights))
        every = np.arange(lights)
        spread[:, every, :, every] = self.covariances
        return spread.reshape(3 * lights, 3 * lights)

    def _spread(self) -> Array:
        """Return the covariance of the positions relative to the surface."""
        up = np.repeat([0.0, 0.0, _HEIGHT_MM], len(self.lights))
        return self._own() + np.outer(up, up)
