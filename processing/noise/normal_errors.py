"""Standard deviations of normals, and what each sample shows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, DataError, Lights
from calibration import StackNoise
from calibration.radiance import check_linear
from processing.noise.pixel_variances import (
    ALIKE,
    UNIFORM,
    Counts,
    Origin,
    PixelVariances,
    SolvedStack,
    common_error,
    pixel_variances,
)
from processing.noise.sample_kind import Reason
from processing.stereo.light_model import check_one_light_each
from processing.stereo.normals_and_albedo import PhotometricStereoResult
from rig import Progress, check_type, no_progress, short_repr
from rig.arrays import Bool, Float32, Float64, UInt8

UNIFORM_DEG: Final = math.degrees(math.sqrt(UNIFORM))
# Least correlation of residuals that are not noise.
STRUCTURED = 0.1


@dataclass(frozen=True, eq=False)
class NormalUncertainty:
    """How sure the normals of an object are, and what its samples show.

    Parameters
    ----------
    sigma_deg
        ``(H, W)`` float32, root mean square angle between estimated and true normal in degrees,
        both tangent directions together, at most `UNIFORM_DEG`; NaN where a pixel is not valid, and
        everywhere if the noise is unknown and the samples are too few to show it.
    common_sigma_deg
        ``(H, W)`` float32, the part of it that is by the errors of lights and mean height, by the
        surface as a whole if it is not matte, and by a stated common error. All pixels have it in
        common: averages over pixels do not make it smaller.
    samples
        ``(6, H, W)`` number of samples of each `SampleKind`, uint8, or uint16 for more than 255
        lights; 0 outside the mask.
    reason
        ``(H, W)`` uint8, the `Reason` why a pixel is not valid.
    noise
        Where the law of the noise is from: ``sensor``, ``repeats``, ``residuals``, or ``unknown``.
    neighbour_correlation
        Correlation, from -1 to 1, between the residuals of each light and of the one nearest to it,
        averaged over pixels. It is about -0.1 where the residuals are noise. Above 0.1 the surface
        is not matte, or light comes from elsewhere. NaN with fewer than 8 lights or 100 pixels.
    """

    sigma_deg: Float32
    common_sigma_deg: Float32
    samples: Counts
    reason: UInt8
    noise: Origin
    neighbour_correlation: float

    __repr__ = short_repr

    @property
    def valid(self) -> Bool:
        """``(H, W)`` bool, pixels with at least 3 lit samples whose lights are not coplanar."""
        return np.asarray(self.reason == Reason.VALID)


def normal_uncertainty(
    values: npt.ArrayLike,
    lights: Lights,
    mask: Bool,
    stereo: PhotometricStereoResult,
    *,
    points_mm: Float64 | None = None,
    camera: CameraModel | None = None,
    depth_sigma: float = 0.0,
    noise: StackNoise | None = None,
    common_deg: float = 0.0,
    on_progress: Progress = no_progress,
) -> NormalUncertainty:
    """Return standard deviations of estimated normals, and classify the samples.

    Each pixel is solved again, from the given normal, by least squares over its lit samples, with
    the reciprocal variances as weights. The variance of the given normal is that of this efficient
    solution plus the square of the angle between both (Hausman, Specification tests in
    econometrics, 1978), whatever the method. Variances are those of the noise and of
    `Lights.errors`, to first order; a light without stated errors counts as exact. Where the
    residuals over 5 x 5 pixels exceed the law of the noise, the variance is larger in proportion.
    Where residuals are alike at pixels that are 4 px apart, the surface is not matte; the errors by
    it are predicted to about a factor of 2 on most surfaces. Errors by the blur of the lens are not
    contained (see `lens_blur`). With a known noise and a matte
    surface, bands of rows that overlap by 2 rows give the values of the whole.

    Parameters
    ----------
    values, lights, mask, points_mm, noise
        As for `photometric_stereo`. Without a law of the noise, one is estimated from the
        differences between neighbouring pixels, if there are 5 images and 100 pixels.
    stereo
        Its result.
    camera
        The camera of near lights, if the points have errors.
    depth_sigma
        Relative standard deviation of the depths of the points from the camera, which all points
        have in common.
    common_deg
        Another error that all normals have in common, degrees: that of a mistake which the images
        show or cannot exclude.
    on_progress
        Receives the stage ``error bars``, one step per pixel.

    Raises
    ------
    DataError
        If shapes or counts differ, near lights have no points, depths have errors and there is no
        camera, or the common error is negative.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Lights
    >>> from processing import photometric_stereo
    >>> from processing.noise import normal_uncertainty
    >>> lights = Lights(directions=[[1, 0, 1], [0, 1, 1], [-1, 0, 1], [0, -1, 1], [0, 0, 1]])
    >>> images = np.sqrt([0.5, 0.5, 0.5, 0.5, 1])[:, None, None] * np.ones((5, 30, 30))
    >>> images += 0.01 * np.random.default_rng(1).normal(size=images.shape)
    >>> mask = images[0] > 0
    >>> found = normal_uncertainty(images, lights, mask, photometric_stereo(images, lights, mask))
    >>> found.samples[:, 0, 0], f"{np.median(found.sigma_deg):.1f}"
    (array([5, 0, 0, 0, 0, 0], dtype=uint8), '0.8')
    """
    check_linear("values", values)
    check_type("lights", lights, Lights, "Lights(directions)")
    stack, mask = np.ascontiguousarray(values, np.float32), np.ascontiguousarray(mask)
    if stack.ndim != 3 or stack.shape[1:] != mask.shape or stereo.albedo.shape != mask.shape:
        raise DataError(
            f"images of shape {stack.shape}, a mask of shape {mask.shape} and normals of shape "
            f"{stereo.albedo.shape} do not fit"
        )
    check_one_light_each(len(stack), lights)
    if not common_deg >= 0:
        raise DataError(
            f"a common error of {common_deg:g} degrees is not a deviation: give 0 or more"
        )
    if depth_sigma and camera is None:
        raise DataError("depths with errors require a camera")
    given = SolvedStack(
        values=stack,
        lights=lights,
        mask=mask,
        normals=stereo.normal_map.normals,
        albedo=stereo.albedo,
        points_mm=points_mm,
        camera=camera,
        depth_sigma=depth_sigma,
        noise=noise,
    )
    found = pixel_variances(given, on_progress=on_progress)
    return as_uncertainty(found, math.radians(common_deg) ** 2)


def as_uncertainty(found: PixelVariances, shared: float = 0.0) -> NormalUncertainty:
    """Return standard deviations in degrees from variances, of which one is shared by all."""
    valid = valid_reasons(found.reason, found.origin)
    common, total = sums_of(found)
    by_model = common_error(found.sums)
    common += np.float32(ALIKE * by_model + shared)
    total += np.float32(by_model + shared)
    in_degrees(total, valid)
    in_degrees(common, valid)
    return NormalUncertainty(
        total, common, found.samples, found.reason, found.origin, found.correlation
    )


def valid_reasons(reason: UInt8, origin: Origin) -> Bool:
    """Return which pixels have error bars, by their `Reason`."""
    return np.asarray((reason == Reason.VALID) & (origin != "unknown"))


def sums_of(found: PixelVariances) -> tuple[Float32, Float32]:
    """Return the variances by lights and height, and all together except for the common ones."""
    common = found.lights + found.height
    return common, found.noise + common + found.model + found.kept * found.difference


def in_degrees(variances: Float32, valid: Bool) -> None:
    """Replace variances in rad^2 by standard deviations in degrees, NaN where not valid.

    They are at most those of a uniform direction.
    """
    np.sqrt(variances, out=variances, where=valid)
    np.degrees(variances, out=variances, where=valid)
    np.minimum(variances, np.float32(UNIFORM_DEG), out=variances)
    variances[~valid] = np.nan
