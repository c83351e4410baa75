"""Standard deviations of normals, and what each sample shows."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from acquisition import DataError, Lights
from calibration import StackNoise, check_linear
from processing._stereo.light_model import LightModel
from processing._stereo.noise_law import NoiseLaw
from processing._stereo.photometric_stereo import PhotometricStereoResult
from processing._uncertainty.light_table import light_table, light_variances
from processing._uncertainty.reference import (
    ANGLE2,
    CHI2,
    FREE,
    HEIGHT,
    LIGHTS,
    NOISE,
    REFERENCE,
    RESULTS,
    reference_solutions,
)
from processing._uncertainty.residual_law import residual_law
from processing._uncertainty.sample_kind import Reason, SampleKind
from rig import Progress, check_type, no_progress, pluralize, short_repr

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_BLOCK = 16384
# Pixels whose residuals show the noise.
_SAMPLED = 4000
# The agreement with the law is averaged over this many pixels across, and drawn toward 1 by a few
# degrees of freedom.
_ACROSS = 5
_PRIOR = 50.0
_LEAST_SCALE = 1e-6


@dataclass(frozen=True, eq=False)
class NormalUncertainty:
    """How sure the normals of an object are, and from which samples they are.

    Parameters
    ----------
    sigma_deg
        ``(H, W)`` float32, root mean square angle between estimated and true normal in degrees,
        both tangent directions together; NaN where a pixel is not valid, and everywhere if the
        noise is unknown and the samples are too few to show it.
    common_sigma_deg
        ``(H, W)`` float32, the part of it that the errors of lights and mean height cause. All
        pixels have it in common: averages over pixels do not make it smaller.
    samples
        ``(6, H, W)`` number of samples of each `SampleKind`, uint8, or uint16 for more than 255
        lights; 0 outside the mask.
    reason
        ``(H, W)`` uint8, a `Reason` for each pixel.
    noise
        Where the law of the noise is from: ``sensor``, ``repeats``, ``residuals``, or ``unknown``.
    """

    sigma_deg: Float
    common_sigma_deg: Float
    samples: npt.NDArray[np.uint8] | npt.NDArray[np.uint16]
    reason: npt.NDArray[np.uint8]
    noise: str

    __repr__ = short_repr

    @property
    def valid(self) -> Mask:
        """``(H, W)`` bool, pixels with at least 3 lit samples whose lights are not coplanar."""
        return np.asarray(self.reason == Reason.VALID)


def normal_uncertainty(
    values: npt.ArrayLike,
    lights: Lights,
    mask: Mask,
    stereo: PhotometricStereoResult,
    *,
    points_mm: npt.ArrayLike | None = None,
    rise_mm: npt.ArrayLike | None = None,
    noise: StackNoise | None = None,
    on_progress: Progress = no_progress,
) -> NormalUncertainty:
    """Return standard deviations of estimated normals, and classify the samples.

    Each pixel is solved again, from the given normal, by least squares over its lit samples, with
    the reciprocal variances as weights. The variance of the given normal is that of this efficient
    solution plus the square of the angle between both (Hausman, Specification tests in
    econometrics, 1978), whatever the method. Variances are those of the noise and of
    `Lights.errors`, to first order; a light without stated errors counts as exact. Where the
    residuals over 5 x 5 pixels exceed the law of the noise, the variance is larger in proportion.

    Parameters
    ----------
    values, lights, mask, points_mm, noise
        As for `photometric_stereo`. Without a law of the noise, one is fitted to the residuals.
    stereo
        Its result.
    rise_mm
        ``(H, W, 3)`` by how much the points move if the mean height is larger by its standard
        deviation; None if the points are exact.
    on_progress
        Receives the stage ``error bars``, one step per pixel.

    Raises
    ------
    DataError
        If shapes or counts differ, or near lights have no points.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Lights
    >>> from processing import normal_uncertainty, photometric_stereo
    >>> lights = Lights(directions=[[1, 0, 1], [0, 1, 1], [-1, 0, 1], [0, -1, 1], [0, 0, 1]])
    >>> images = np.sqrt([0.5, 0.5, 0.5, 0.5, 1])[:, None, None] * np.ones((5, 30, 30))
    >>> values, mask = images + 0.01 * np.random.default_rng(1).normal(size=(5, 30, 30)), images[0] > 0
    >>> found = normal_uncertainty(values, lights, mask, photometric_stereo(values, lights, mask))
    >>> found.samples[:, 0, 0], float(np.median(found.sigma_deg).round(1))
    (array([5, 0, 0, 0, 0, 0], dtype=uint8), 0.8)
    """
    check_linear("values", values)
    check_type("lights", lights, Lights, "Lights(directions)")
    stack, mask = np.ascontiguousarray(values, np.float32), np.ascontiguousarray(mask)
    if stack.ndim != 3 or stack.shape[1:] != mask.shape or stereo.albedo.shape != mask.shape:
        raise DataError(
            f"error bars: a stack of shape {stack.shape}, a mask of {mask.shape} and normals of "
            f"{stereo.albedo.shape} do not fit"
        )
    if len(stack) != len(lights):
        raise DataError(
            f"{pluralize(len(stack), 'image')} for {pluralize(len(lights), 'light')}: give "
            "one light for each image"
        )
    pixels = np.flatnonzero(mask)
    solver = _Solver(stack, lights, mask, stereo, points_mm, rise_mm)
    law = None if noise is None else NoiseLaw(noise, (len(stack), *mask.shape))
    origin = "residuals" if noise is None else noise.origin
    fitted = None
    if law is None:
        fitted = solver.fitted_law(pixels)
        origin = "unknown" if fitted is None else origin
    counts = np.zeros((len(SampleKind), mask.size), np.uint8 if len(stack) < 256 else np.uint16)
    reason = np.zeros(mask.size, np.uint8)
    parts = np.zeros((5, mask.size), np.float32)  # noise and lights, lights, rest, chi2, free
    for first in range(0, len(pixels), _BLOCK):
        block = pixels[first : first + _BLOCK]
        samples, vectors = solver.model.samples(stack, block)
        known = fitted if law is None else law.of(block, samples, vectors)
        _, of_block, results = solver.solve(block, samples, vectors, known)
        counts[:, block] = of_block.T
        good = np.isfinite(results[:, NOISE])
        reason[block] = _reasons(of_block, good, stereo.albedo.flat[block] > 0)
        parts[:, block[good]] = _parts(results[good])
        on_progress("error bars", min(first + _BLOCK, len(pixels)), len(pixels))
    valid = (reason == Reason.VALID).reshape(mask.shape)
    own, common, rest, chi2, free = parts.reshape(5, *mask.shape)
    factor = _agreement(chi2, free, at_least_1=noise is not None)
    sigma = np.full(mask.shape, np.nan, np.float32)
    of_common = np.full(mask.shape, np.nan, np.float32)
    if origin != "unknown":
        sigma[valid] = np.degrees(np.sqrt((factor * own + rest)[valid]))
        of_common[valid] = np.degrees(np.sqrt(common[valid]))
    return NormalUncertainty(
        sigma,
        of_common,
        counts.reshape(-1, *mask.shape),
        reason.reshape(mask.shape),
        origin,
    )


class _Solver:
    """Reference solutions of blocks of pixels."""

    def __init__(
        self,
        stack: Float,
        lights: Lights,
        mask: Mask,
        stereo: PhotometricStereoResult,
        points_mm: npt.ArrayLike | None,
        rise_mm: npt.ArrayLike | None,
    ) -> None:
        self.model = LightModel(lights, points_mm, mask)
        self._stack = stack
        self._near = lights.near
        self._table = light_table(lights)
        self._errors = bool(self._table[:, 8:17].any()) or (lights.near and rise_mm is not None)
        self._normals = stereo.normal_map.normals.reshape(-1, 3)
        self._albedo = stereo.albedo.reshape(-1)
        self._points = None if points_mm is None else np.asarray(points_mm, np.float64)
        self._rise = None if rise_mm is None else np.asarray(rise_mm, np.float64)

    def solve(
        self, pixels: npt.NDArray[np.intp], samples: Float, vectors: Float, law: Float | None
    ) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.int64], Double]:
        """Return the kinds ``(P, N)``, their numbers, and the results of some pixels."""
        starts = self._normals[pixels] * self._albedo[pixels, None].astype(np.float64)
        kinds = np.zeros(samples.shape, np.uint8)
        counts = np.zeros((len(pixels), len(SampleKind)), np.int64)
        results = np.zeros((len(pixels), RESULTS))
        nowhere = np.zeros((1, 3))
        points = rises = nowhere
        if self._near and self._points is not None:
            points = self._points.reshape(-1, 3)[pixels]
            rises = np.zeros_like(points)
            if self._rise is not None:
                rises = self._rise.reshape(-1, 3)[pixels]
        wide = np.zeros((1, 2, samples.shape[1]), np.float32)
        wide[:, 0] = 1
        if law is not None:
            wide = np.ascontiguousarray(np.broadcast_to(law, (len(law), 2, samples.shape[1])))
        reference_solutions(
            samples,
            vectors,
            wide,
            starts,
            np.float32(_LEAST_SCALE if law is None else 1.0),
            self._table,
            self._errors and law is not None,
            self._near,
            points,
            rises,
            kinds,
            counts,
            results,
        )
        return kinds, counts, results

    def fitted_law(self, pixels: npt.NDArray[np.intp]) -> Float | None:
        """Return the law of the noise that the residuals of some pixels show."""
        some = pixels[:: max(1, len(pixels) // _SAMPLED)]
        samples, vectors = self.model.samples(self._stack, some)
        kinds, _, results = self.solve(some, samples, vectors, None)
        of_lights = np.zeros(samples.shape)
        if self._errors:
            solutions = np.nan_to_num(results[:, REFERENCE])
            points = np.zeros((1, 3)) if self._points is None else self._points.reshape(-1, 3)[some]
            light_variances(vectors, solutions, self._table, self._near, points, of_lights)
        return residual_law(samples, vectors, kinds, results, of_lights)


def _parts(results: Double) -> Double:
    """Return noise and lights, common part, what no factor enlarges, chi2 and freedom: ``(5, P)``."""
    noise, lights, height = results[:, NOISE], results[:, LIGHTS], results[:, HEIGHT]
    rest = results[:, ANGLE2] + height
    return np.stack([noise + lights, lights + height, rest, results[:, CHI2], results[:, FREE]])


def _reasons(counts: npt.NDArray[np.int64], good: Mask, solved: Mask) -> npt.NDArray[np.uint8]:
    if good.all():
        return np.full(len(good), Reason.VALID, np.uint8)
    lit, attached, cast, saturated, outlier, missing = counts.T
    lost = np.stack([saturated + missing, attached + cast, outlier])
    few = np.array([Reason.SATURATED, Reason.SHADOW, Reason.OUTLIERS])[np.argmax(lost, axis=0)]
    reason = np.where(lit < 3, few, Reason.COPLANAR)
    measured = lit + attached + cast + outlier
    unsolved = np.where(measured < 3, Reason.SATURATED, Reason.UNSOLVED)
    reason = np.where(solved, reason, unsolved)
    return np.where(good, Reason.VALID, reason).astype(np.uint8)


def _agreement(chi2: Float, free: Float, *, at_least_1: bool) -> Float:
    """Return the mean square of the normalised residuals around each pixel."""
    size = (_ACROSS, _ACROSS)
    total, number = (
        cv2.boxFilter(part, -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
        for part in (chi2, free)
    )
    factor = (total + _PRIOR) / (number + _PRIOR)
    return np.asarray(np.maximum(factor, 1) if at_least_1 else factor, np.float32)
