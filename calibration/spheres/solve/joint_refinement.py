"""One least squares over the positions of all lights and the centres of all spheres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition import CameraModel
from calibration._errors import EstimateError
from calibration.spheres.geometry.reflection import mirror_points
from rig import short_repr
from rig.arrays import Float64

# The variances are as stated with the weight of so many residuals: few show little.
EXPECTED = 4
_ROUNDS, _CONVERGED_MM = 8, 1e-6
_WORST_SHARE = 0.25
_STEP_MM = 1e-3


@dataclass(frozen=True, eq=False)
class KnownSpheres:
    """K spheres in the house frame.

    Parameters
    ----------
    centres_mm
        ``(K, 3)``.
    radii_mm
        ``(K,)``.
    covariance_mm2
        ``(3 K, 3 K)`` covariance of the centres from the outlines.
    """

    centres_mm: Float64
    radii_mm: Float64
    covariance_mm2: Float64

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class Observation:
    """Highlights of N lights on K spheres, as a camera sees them.

    Parameters
    ----------
    camera
        Camera with a working distance.
    spheres
        K spheres as their outlines show them.
    highlights_px
        ``(N, K, 2)``; NaN if a light has no highlight on a sphere.
    sigma_px
        ``(N, K)`` standard deviations of each coordinate of a highlight; infinite for highlights
        that do not count.
    """

    camera: CameraModel
    spheres: KnownSpheres
    highlights_px: Float64
    sigma_px: Float64


@dataclass(frozen=True, eq=False)
class Refined:
    """Positions of N lights and K spheres that explain highlights and outlines together.

    Parameters
    ----------
    positions_mm
        ``(N, 3)``.
    centres_mm
        ``(K, 3)``.
    covariance_mm2
        ``(N, 3, 3)`` covariance of each position, with the errors of the centres included.
    independent_mm2
        ``(N, 3, 3)`` the part of it that the lights do not share; zero if glare may be shared.
    chi_square
        Sum of the squared errors of highlights and centres relative to their covariances, divided
        by the degrees of freedom; NaN without any.
    """

    positions_mm: Float64
    centres_mm: Float64
    covariance_mm2: Float64
    independent_mm2: Float64
    chi_square: float

    __repr__ = short_repr


def predicted_highlights(
    camera: CameraModel, centres_mm: Float64, radii_mm: Float64, lights_mm: Float64
) -> Float64:
    """Return the pixels ``(N, K, 2)`` of the highlights of N lights on K spheres."""
    points = mirror_points(camera.centre_mm, lights_mm[:, None], centres_mm[None], radii_mm[None])
    return camera.project(points)


def refine(
    seen: Observation, positions_mm: Float64, ids: tuple[str, ...], *, peaks: bool = False
) -> Refined:
    """Refine all lights and sphere centres by Gauss-Newton with a Schur complement.

    The sum of the squared errors of the highlights, relative to their standard deviations, and of
    the squared deviations of the centres from those given by the outlines, relative to their
    covariance, is minimised. The covariance of the positions has two parts. That of the highlights
    is multiplied by the reduced chi-square if that exceeds 1, because then their errors are larger
    than stated, and also if it is below 1 and the errors are independent. That of the outlines is
    multiplied by how much the centres deviate from the outlines, under the same conditions.

    Parameters
    ----------
    seen
        Highlights and spheres.
    positions_mm
        ``(N, 3)`` start values.
    ids
        N names of the lights, for messages.
    peaks
        Whether the highlights are unsaturated peaks, whose errors (photon noise) are independent.
        Glare moves saturated ones alike on all spheres, which the residuals do not show.

    Raises
    ------
    EstimateError
        If the standard deviation of a position exceeds a quarter of its distance.
    """
    lights, centres = positions_mm, seen.spheres.centres_mm.copy()
    for _ in range(_ROUNDS):
        system = linearise(seen, lights, centres)
        _check_determined(system.of_light, lights, ids)
        move_light, move_centre = system.steps()
        # Limit the step to a fifth of the distance, where the linear model is valid.
        longest = 0.2 * np.linalg.norm(lights, axis=1)
        length = np.linalg.norm(move_light, axis=1)
        lights = lights + move_light * np.minimum(1, longest / np.maximum(length, 1e-12))[:, None]
        centres = centres + move_centre
        if max(float(length.max()), float(np.abs(move_centre).max())) < _CONVERGED_MM:
            break
    system = linearise(seen, lights, centres)
    freedom = degrees_of_freedom(seen.sigma_px)
    chi_square = system.square / freedom if freedom > 0 else float("nan")
    share = max(chi_square, 1.0) if freedom > 0 else 1.0
    if peaks and share == 1:
        share = min((system.square + EXPECTED) / (freedom + EXPECTED), 1.0)
    outlines_share = system.outlines_share((centres - seen.spheres.centres_mm).ravel())
    outlines_share = outlines_share if peaks else max(outlines_share, 1.0)
    covariance = system.covariance(share, outlines_share)
    own: Float64 = np.asarray(np.linalg.inv(system.of_light), np.float64)
    independent = (share if peaks else 0.0) * own
    return Refined(lights, centres, covariance, independent, chi_square)


def degrees_of_freedom(sigma_px: Float64) -> int:
    """Return how many more coordinates highlights ``(N, K)`` have than their lights.

    Outlines give as many values as there are unknowns of the centres.
    """
    return 2 * int(np.isfinite(sigma_px).sum()) - 3 * len(sigma_px)


@dataclass(frozen=True, eq=False)
class System:
    """Normal equations of N lights and K centres.

    ``of_light (N, 3, 3)``, ``cross (N, 3, 3 K)`` and ``of_centre (3 K, 3 K)`` are the blocks of the
    information matrix, ``of_outlines`` is what the outlines contribute to the last one,
    ``pull_light (N, 3)`` and ``pull_centre (3 K,)`` its right side, ``square``
    is the sum of the squared errors, and ``by_light`` and ``by_centre (N, K, 2, 3)`` are the
    derivatives of the highlights.
    """

    of_light: Float64
    cross: Float64
    of_centre: Float64
    of_outlines: Float64
    pull_light: Float64
    pull_centre: Float64
    square: float
    by_light: Float64
    by_centre: Float64

    __repr__ = short_repr

    def _eliminated(self) -> tuple[Float64, Float64]:
        """Return ``of_light^-1 cross`` and the information about the centres without the lights."""
        gain: Float64 = np.asarray(np.linalg.solve(self.of_light, self.cross), np.float64)
        schur: Float64 = self.of_centre - np.einsum("nap,naq->pq", self.cross, gain)
        return gain, schur

    def steps(self) -> tuple[Float64, Float64]:
        """Return the Gauss-Newton steps ``(N, 3)`` of the lights and ``(K, 3)`` of the centres."""
        of_light, of_centre = self.solve(self.pull_light, self.pull_centre)
        return -of_light, -of_centre.reshape(-1, 3)

    def solve(self, light: Float64, centre: Float64) -> tuple[Float64, Float64]:
        """Return the inverse of the information times a vector ``(N, 3)``, ``(3 K,)``."""
        gain, schur = self._eliminated()
        right = centre - np.einsum("nap,na->p", gain, light)
        of_centre: Float64 = np.asarray(np.linalg.solve(schur, right), np.float64)
        left = (light - self.cross @ of_centre)[..., None]
        of_light: Float64 = np.asarray(np.linalg.solve(self.of_light, left), np.float64)[..., 0]
        return of_light, of_centre

    def square_at_minimum(self) -> float:
        """Return the sum of the squared errors after a step, if the system is linear."""
        of_light, of_centre = self.solve(self.pull_light, self.pull_centre)
        change = np.sum(of_light * self.pull_light) + of_centre @ self.pull_centre
        return self.square - float(change)

    def log_determinant(self) -> float:
        """Return the logarithm of the determinant of the information."""
        _, schur = self._eliminated()
        lights = np.linalg.slogdet(self.of_light).logabsdet.sum()
        return float(lights + np.linalg.slogdet(schur).logabsdet)

    def outlines_share(self, off: Float64) -> float:
        """Return the variance of the outlines in multiples of that stated.

        ``off (3 K,)`` is how far the centres are from the outlines; what the highlights do not
        determine follows the outlines and shows nothing about them.
        """
        _, schur = self._eliminated()
        freedom = len(off) - float(np.trace(np.linalg.solve(schur, self.of_outlines)))
        square = float(off @ self.of_outlines @ off)
        return (square + EXPECTED) / (freedom + EXPECTED)

    def covariance(self, share: float = 1.0, outlines_share: float = 1.0) -> Float64:
        """Return the covariances ``(N, 3, 3)`` of the lights.

        ``share`` and ``outlines_share`` are the variances of highlights and outlines in multiples
        of those with which they count. If both are 1, these are blocks of the inverse of the
        information.
        """
        gain, schur = self._eliminated()
        inverse = np.linalg.inv(schur)
        shared = np.einsum("nap,pq,nbq->nab", gain, inverse, gain)
        outlines = inverse @ self.of_outlines @ inverse
        of_outlines: Float64 = np.einsum("nap,pq,nbq->nab", gain, outlines, gain)
        inside: Float64 = np.linalg.inv(self.of_light) + shared
        return share * inside + (outlines_share - share) * of_outlines


@dataclass(frozen=True, eq=False)
class Slopes:
    """Errors of the predicted highlights, and their derivatives, before they are weighted.

    ``error (N, K, 2)`` is predicted minus observed, 0 for highlights that do not count;
    ``by_light`` and ``by_centre (N, K, 2, 3)`` are its derivatives, ``off (3 K,)`` is how far the
    centres are from the outlines, and ``of_outlines (3 K, 3 K)`` is the information of the outlines
    about them.
    """

    error: Float64
    by_light: Float64
    by_centre: Float64
    off: Float64
    of_outlines: Float64

    __repr__ = short_repr

    def weighted(self, sigma_px: Float64) -> System:
        """Return the normal equations with ``(N, K)`` standard deviations of the highlights."""
        n, k = sigma_px.shape
        weight = weights_of(sigma_px)
        of_centre = self.of_outlines.copy()
        blocks = np.einsum("nkia,nki,nkib->kab", self.by_centre, weight, self.by_centre)
        for j in range(k):
            of_centre[3 * j : 3 * j + 3, 3 * j : 3 * j + 3] += blocks[j]
        cross = np.einsum("nkia,nki,nkib->nakb", self.by_light, weight, self.by_centre)
        pull = np.einsum("nkia,nki->ka", self.by_centre, weight * self.error).ravel()
        return System(
            of_light=np.einsum("nkia,nki,nkib->nab", self.by_light, weight, self.by_light),
            cross=cross.reshape(n, 3, 3 * k),
            of_centre=of_centre,
            of_outlines=self.of_outlines,
            pull_light=np.einsum("nkia,nki->na", self.by_light, weight * self.error),
            pull_centre=pull + self.of_outlines @ self.off,
            square=float(np.sum(weight * self.error**2) + self.off @ self.of_outlines @ self.off),
            by_light=self.by_light,
            by_centre=self.by_centre,
        )


def weights_of(sigma_px: Float64) -> Float64:
    """Return the weights ``(N, K, 2)`` of highlights; 0 for those that do not count."""
    sigma_px = np.where(np.isfinite(sigma_px), sigma_px, np.inf)
    return np.asarray(sigma_px[..., None] ** -2.0 * np.ones(2))


def slopes_at(seen: Observation, lights: Float64, centres: Float64) -> Slopes:
    """Return errors and derivatives of the highlights ``(N, K)`` that count, as in `refine`."""
    spheres, use = seen.spheres, np.isfinite(seen.sigma_px)
    observed = np.where(use[..., None], seen.highlights_px, 0.0)

    def errors(at_lights: Float64, at_centres: Float64) -> Float64:
        predicted = predicted_highlights(seen.camera, at_centres, spheres.radii_mm, at_lights)
        return np.where(use[..., None], predicted - observed, 0.0)

    steps = np.eye(3) * _STEP_MM
    by_light = np.stack(
        [errors(lights + step, centres) - errors(lights - step, centres) for step in steps], axis=-1
    )
    by_centre = np.stack(
        [errors(lights, centres + step) - errors(lights, centres - step) for step in steps], axis=-1
    )
    return Slopes(
        error=errors(lights, centres),
        by_light=by_light / (2 * _STEP_MM),
        by_centre=by_centre / (2 * _STEP_MM),
        off=(centres - spheres.centres_mm).ravel(),
        of_outlines=np.asarray(np.linalg.inv(spheres.covariance_mm2), np.float64),
    )


def linearise(seen: Observation, lights: Float64, centres: Float64) -> System:
    """Return the normal equations of the errors that `refine` minimises, with its parameters."""
    return slopes_at(seen, lights, centres).weighted(seen.sigma_px)


def _check_determined(of_light: Float64, positions: Float64, ids: tuple[str, ...]) -> None:
    """Raise `EstimateError` if the uncertainty of a position is large relative to its distance."""
    values = np.linalg.eigvalsh(of_light)
    deviation = 1 / np.sqrt(np.maximum(values[:, 0], 1e-30))
    share = deviation / np.linalg.norm(positions, axis=1)
    worst = int(np.argmax(share))
    if not share[worst] < _WORST_SHARE:
        raise EstimateError(
            f"the distance of light {ids[worst]} is not determined, because its reflected rays are "
            "nearly parallel: move the spheres apart, or leave out the radius to get directions"
        )
