"""Constant light, such as that of the room, from images under lights of several elevations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition import Lights
from calibration import EstimateError
from processing.images.recorded_images import Images
from processing.images.viewing_rays import View
from processing.series.series_fit import Parameter, SeriesCells, SharedModel
from processing.stereo.light_model import check_one_light_each
from rig import pluralize, short_repr
from rig.arrays import Bool, Float32, Float64

_FEWEST_LIGHTS = 5
# Deviation of a constant from what the normal of a pixel explains, at least: it is the scatter of
# the sines of the elevations relative to their mean.
_LEAST_CONTRAST = 0.05
# A larger standard deviation of the constant light, relative to a light, is refused.
_UNKNOWN = 0.05
# Widths of the priors of the other terms, which are within two of them: light from two sides, from
# below, and terms of the second order, which are weaker in all surroundings.
_WIDTHS = (0.03, 0.03, 0.1, 0.05, 0.01, 0.01, 0.01, 0.01)
_HIGHEST = 5.0
# Share of the radius of the object by which its mean height may differ from the working plane.
_HEIGHT = 0.5


@dataclass(frozen=True, eq=False)
class AmbientLight:
    """Constant light on a surface, relative to the irradiance of a light of mean intensity.

    Parameters
    ----------
    coefficients
        ``(4,)`` factors of `ambient_terms`; the first one is the irradiance of a surface that faces
        the camera.
    covariance
        ``(4, 4)`` of the coefficients.
    shares
        ``(N,)`` its part in images that are divided by the intensities of the lights: a room is as
        bright under a weak light as under a strong one.
    pull
        ``(3,)`` change of the scaled normal by a constant light of 1.
    mean_height_mm
        Mean height of the object that was found with it, under near lights; else 0.
    """

    coefficients: Float64
    covariance: Float64
    shares: Float64
    pull: Float64
    mean_height_mm: float

    __repr__ = short_repr

    @property
    def level(self) -> float:
        """Irradiance of a surface that faces the camera."""
        return float(self.coefficients[0])

    @property
    def sigma(self) -> float:
        """Standard deviation of the level."""
        return float(np.sqrt(self.covariance[0, 0]))

    def seen_with(self, normals: Float32, albedo: Float32) -> Float32:
        """Return the constant light ``(...)`` of pixels that were solved with it in the images."""
        constant = ambient_terms(normals) @ self.coefficients
        pulled = constant * (normals @ self.pull)
        return np.asarray(albedo * constant / (1 + np.maximum(pulled, -0.5)), np.float32)

    def seen(self, normals: Float32, albedo: Float32) -> Float32:
        """Return the constant light ``(...)`` of pixels with normals ``(..., 3)`` and an albedo."""
        return np.asarray(albedo * (ambient_terms(normals) @ self.coefficients), np.float32)

    def variance(self, normals: Float32) -> Float32:
        """Return the variance of normals ``(..., 3)`` by the error of the light, rad^2."""
        terms = ambient_terms(normals)
        of_light = np.einsum("...i,ij,...j->...", terms, self.covariance, terms)
        across = np.sum(self.pull**2) - (normals @ self.pull) ** 2
        return np.asarray(of_light * np.maximum(across, 0), np.float32)


def ambient_terms(normals: Float32 | Float64) -> Float64:
    """Return the irradiance ``(..., 4)`` of surfaces with normals ``(..., 3)``.

    They are those of a uniform sky above, of its gradients across, and of light from below: the
    first two orders of the irradiance of any surroundings (Ramamoorthi and Hanrahan, 2001).
    """
    x, y, z = np.moveaxis(np.asarray(normals, np.float64), -1, 0)
    second = (3 * z**2 - 1) / 2 - z, x * z, y * z, x * y, (x**2 - y**2) / 2
    return np.stack([(1 + z) / 2, x, y, (1 - z) / 2, *second], axis=-1)


def find_ambient_light(values: Images, lights: Lights, mask: Bool, view: View) -> AmbientLight:
    """Estimate a constant light that is in all images.

    It is fitted together with normals, albedo and reflectance of pixels all over the object, and
    under near lights with shape and mean height, with Cauchy weights. A constant is not one of the
    images that a matte surface can have under these lights, unless all are at the same elevation.

    Parameters
    ----------
    values
        ``(N, H, W)`` float32 linear radiance, divided by the intensities of the lights.
    lights
        N lights.
    mask
        ``(H, W)`` bool, the object.
    view
        How the pixels see the surface.

    Raises
    ------
    DataError
        If the lights are not as many as the images.
    EstimateError
        If there are fewer than 5 lights, their elevations are alike, or the images do not determine
        the constant light.
    """
    check_one_light_each(len(values), lights)
    if len(lights) < _FEWEST_LIGHTS:
        raise EstimateError(
            f"{pluralize(len(lights), 'light does', 'lights do')} not determine a constant light: "
            f"at least {_FEWEST_LIGHTS} are required"
        )
    away, strength = lights.unit_directions, np.asarray(lights.intensities).mean(axis=1)
    shares = np.asarray(strength.mean() / strength, np.float64)
    pull = np.linalg.lstsq(away, shares, rcond=None)[0]
    contrast = float(np.sqrt(np.mean((shares - away @ pull) ** 2)))
    if contrast < _LEAST_CONTRAST:
        raise EstimateError(
            "the lights are at nearly the same elevation, where a constant light looks like a "
            "brighter surface with other normals: it cannot be estimated; record a frame with all "
            "lights off, or add lights at other elevations"
        )
    cells = SeriesCells(values, mask, view)
    unit = np.broadcast_to(away, (len(cells.places), *away.shape))

    def vectors(values: Float64, points: Float64) -> Float64:
        return lights.vectors_at(points).transpose(1, 0, 2) if lights.near else unit

    radius = cells.radius_mm
    height = Parameter(0.0, _HEIGHT * radius, 0.01 * radius, -radius, radius)
    model = SharedModel(
        (height,) if lights.near else (),
        vectors,
        lambda values: cells.rays,
        lambda values: -float(values[0]) if lights.near else 0.0,
        (
            Parameter(0.0, np.inf, 0.005, 0.0, _HIGHEST),
            *[Parameter(0.0, width, 0.005, -2 * width, 2 * width) for width in _WIDTHS],
        ),
        lambda normals: ambient_terms(normals)[:, None] * shares[:, None],
    )
    found = cells.best(model, [np.zeros(0)])
    first = len(model.parameters)
    covariance = np.asarray(found.covariance[first:, first:], np.float64)
    sigma = float(np.sqrt(covariance[0, 0]))
    if not sigma < _UNKNOWN:
        raise EstimateError(
            "the images do not determine the constant light (standard deviation "
            f"{min(sigma, 9.99):.0%} of a light): record a frame with all lights off"
        )
    return AmbientLight(
        found.values[first:],
        covariance,
        shares,
        np.asarray(pull, np.float64),
        float(found.values[0]) if first else 0.0,
    )
