"""Distance of the lights of a dome, whose list has only directions, from its images."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from acquisition import DataError, LightErrors, Lights
from calibration import EstimateError
from processing.images.recorded_images import Images
from processing.images.viewing_rays import Parallel, View
from processing.series.series_fit import Parameter, SeriesCells, SharedModel
from processing.stereo.light_model import check_one_light_each
from rig import Notice
from rig.arrays import Bool, Float64

# Reciprocal distances that are tried, and the largest one, relative to that of half of the object.
_TRIED = (0.0, 0.15, 0.3, 0.45)
_NEAREST = 0.7
# Lamps are equally bright in all directions (0) up to Lambertian and facing the object (1): mean
# and standard deviation of an exponent about which nothing else is known.
_EVEN, _LAMBERTIAN = 0.0, 1.0
_LOBE, _LOBE_SIGMA = 0.5, 0.29
# Reciprocal distance of a camera of which nothing is known, times the radius of the object.
_CAMERA, _CAMERA_SIGMA = 0.15, 0.08
# Relative error by that of the heights, as a share of the range of the heights: those of jumps are
# not known. Relative error that is left on simulated objects, and that of the reciprocal distance
# times the radius of the object, of all objects and by what the reflectance adds: a slight fall-off
# looks like another reflectance.
_SHAPE, _LEFT, _FALL_OFF, _REFLECTED = 0.15, 0.025, 0.002, 0.12
# Relative standard deviations that are reported and refused, and standard deviations of a range.
_UNCERTAIN, _UNKNOWN = 0.1, 0.2
_RANGE = 2.0
_LEAST_COSINE = 1e-3


@dataclass(frozen=True)
class LightDistance:
    """Distance of all lights from the middle of the object.

    Parameters
    ----------
    distance_mm, sigma_mm
        The distance and its standard deviation; 0 if it is stated.
    mu, mu_sigma
        Exponent of the radiation pattern of the lamps, which face the object, 0 to 1, and its
        standard deviation.
    """

    distance_mm: float
    sigma_mm: float = 0.0
    mu: float = 0.0
    mu_sigma: float = 0.0

    @property
    def warnings(self) -> tuple[Notice, ...]:
        """A warning if the distance is known only roughly."""
        if self.sigma_mm <= _UNCERTAIN * self.distance_mm:
            return ()
        near, sigma = 1 / self.distance_mm, self.sigma_mm / self.distance_mm**2
        text = (
            "the images determine the distance of the lights only roughly: it is "
            f"{_range(near, sigma)}; measure and state it"
        )
        return (Notice("light-distance-uncertain", text),)

    def lights(self, lights: Lights, middle_mm: npt.ArrayLike = (0.0, 0.0, 0.0)) -> Lights:
        """Return lights with directions at this distance, see `Lights.at_distance`.

        The error of the distance is part of the errors of their positions, as if it were that of
        each light.
        """
        directions = lights.unit_directions
        near = lights.at_distance(self.distance_mm, middle_mm)
        if not self.sigma_mm:
            return near
        along = directions[:, :, None] * directions[:, None] * self.sigma_mm**2
        errors = LightErrors() if near.errors is None else near.errors
        across = 0.0 if errors.covariances is None else np.nan_to_num(errors.covariances)
        count = len(directions)
        mu, mu_std = np.full(count, self.mu), np.full(count, self.mu_sigma)
        errors = replace(errors, covariances=across + along, mu_std=mu_std)
        return replace(near, mu=mu, errors=errors)


def find_light_distance(
    values: Images,
    lights: Lights,
    mask: Bool,
    view: View,
    middle_mm: npt.ArrayLike = (0.0, 0.0, 0.0),
) -> LightDistance:
    """Estimate the distance of lights of which only the directions are known.

    All lights are at one distance D from the middle of the object. On pixels all over the object,
    1/D, the radiation pattern of the lamps, the mean height of the object and its reflectance are
    fitted together with normals, albedo and shape, with Cauchy weights, from several values of 1/D
    that include distant lights; without a camera, so is the distance from which the object is seen.
    The standard deviation contains the scatter between parts of the object, a share of its heights
    and of its gloss, and what is left on simulated objects.

    Parameters
    ----------
    values
        ``(N, H, W)`` float32 linear radiance, divided by the intensities of the lights; of complete
        images or of averages of blocks.
    lights
        N lights with directions, from the middle of the object.
    mask
        ``(H, W)`` bool, the object.
    view
        How the pixels see the surface, for instance `Parallel` with the size of a pixel.
    middle_mm
        The point that the directions refer to.

    Raises
    ------
    DataError
        If the lights have positions, or are not as many as the images.
    EstimateError
        If the images do not determine the distance to 20 %. The message contains the range of two
        standard deviations.
    """
    if lights.near:
        raise DataError("the lights have positions: a distance is for lights with directions")
    check_one_light_each(len(values), lights)
    away = lights.unit_directions
    cells = SeriesCells(values, mask, view)
    middle, radius = np.asarray(middle_mm, np.float64), cells.radius_mm

    def vectors(values: Float64, points: Float64) -> Float64:
        """Return light vectors in terms of 1/D and mu; see `Lights.vectors_at`."""
        toward = away - values[0] * (points - middle)[:, None]
        square = np.einsum("pnc,pnc->pn", toward, toward)
        length = np.sqrt(square)
        cosine = np.maximum(np.einsum("nc,pnc->pn", away, toward) / length, _LEAST_COSINE)
        gain = cosine ** values[1] / (square * length)
        return np.asarray(toward * gain[..., None], np.float64)

    parameters = (
        Parameter(0.0, np.inf, 0.005 / radius, 0.0, _NEAREST / radius),
        Parameter(_LOBE, _LOBE_SIGMA, 0.05, _EVEN, _LAMBERTIAN),
        Parameter(0.0, radius, 0.01 * radius),  # the mean height
        Parameter(_CAMERA / radius, _CAMERA_SIGMA / radius, 0.01 / radius, 0.0, _NEAREST / radius),
    )
    parallel = isinstance(view, Parallel)

    def rays(values: Float64) -> Float64:
        """Return the rays of a camera at an unknown distance, in terms of its reciprocal."""
        if not parallel:
            return cells.rays
        across = cells.flat_points * [values[3], values[3], 0.0]
        return np.asarray(cells.rays + across, np.float64)

    model = SharedModel(
        parameters if parallel else parameters[:3], vectors, rays, lambda values: -float(values[2])
    )
    found = cells.best(model, [np.array([near / radius]) for near in _TRIED])
    near, mu = found.values[:2]
    sigma, mu_sigma = np.sqrt(np.diag(found.covariance)[:2])
    heights = _SHAPE * found.relief_mm / radius
    alike = (_FALL_OFF + _REFLECTED * found.reflectance) / radius
    sigma = math.hypot(sigma, heights * near, _LEFT * near, alike)
    if not sigma < _UNKNOWN * near:
        raise EstimateError(_not_determined(near, sigma))
    return LightDistance(1 / near, sigma / near**2, float(mu), float(mu_sigma))


def _not_determined(near: float, sigma: float) -> str:
    return (
        "the images do not determine the distance of the lights to "
        f"{_UNKNOWN * 100:.0f} %: it is {_range(near, sigma)}; measure and "
        "state it, or give a camera with its working distance"
    )


def _range(near: float, sigma: float) -> str:
    least, most = near - _RANGE * sigma, near + _RANGE * sigma
    further = f"to {1 / least:.0f} mm" if least > 0 else "or at any larger distance"
    return f"from {1 / most:.0f} mm {further}"
