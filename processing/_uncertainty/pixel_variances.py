"""Reference solutions of all pixels of an image, with their variances."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, cast

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, Lights
from calibration import StackNoise
from processing._stereo.frames import Frames
from processing._stereo.image_noise import ImageLaw, law_of_images
from processing._stereo.light_model import LightModel
from processing._stereo.noise_law import NoiseLaw
from processing._stereo.photometric_stereo import PhotometricStereoResult
from processing._uncertainty.light_table import ERRORS, light_table
from processing._uncertainty.model_error import agreement, model_errors
from processing._uncertainty.reference import (
    NOISE,
    REFERENCE,
    RESULTS,
    VARIANCES,
    reference_solutions,
)
from processing._uncertainty.residual_structure import neighbour_correlation
from processing._uncertainty.sample_kind import Reason, SampleKind
from rig import Progress, in_threads, short_repr

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Counts = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]

# Where a law of the noise is from.
Origin = Literal["sensor", "repeats", "residuals", "unknown"]

_BLOCK = 16384
# Pixels whose residuals show the noise, and whether they are noise.
_SAMPLED = 4000
# Fewest images and pixels whose differences show that there is no noise.
_FEWEST_IMAGES = 5
_FEWEST_PIXELS = 100
_LEAST_SCALE = 1e-6


@dataclass(frozen=True, eq=False)
class PixelVariances:
    """Reference solutions and their variances in rad^2.

    Parameters
    ----------
    noise, lights, height
        ``(H, W)`` variances of the direction of the reference by the noise, the errors of the
        lights, and that of the mean height. Noise and lights are scaled by the agreement of the
        residuals with them.
    model, common_model
        ``(H, W)`` variances where the surface is not matte, and the part of them that all pixels
        have, see `model_errors`.
    difference
        ``(H, W)`` squared angles between the given normals and the reference.
    kept
        ``(H, W)`` share 0..1 of the difference that is an error of the given normals.
    reference
        ``(H, W, 3)`` unit normals of the reference; None if they were not requested.
    samples, reason
        As in `NormalUncertainty`.
    origin
        Where the law of the noise is from.
    correlation
        See `neighbour_correlation`.
    """

    noise: Float
    lights: Float
    height: Float
    model: Float
    common_model: float
    difference: Float
    kept: Float
    reference: Float | None
    samples: Counts
    reason: npt.NDArray[np.uint8]
    origin: Origin
    correlation: float

    __repr__ = short_repr


def pixel_variances(
    stack: Float,
    lights: Lights,
    mask: Mask,
    scaled: tuple[Float, Float],
    *,
    points_mm: npt.NDArray[np.float64] | None,
    camera: CameraModel | None,
    depth_sigma: float,
    noise: StackNoise | None,
    keep_reference: bool,
    on_progress: Progress,
    estimated: ImageLaw | None = None,
) -> PixelVariances:
    """Solve all pixels of a mask again.

    Parameters
    ----------
    stack
        ``(N, H, W)``.
    scaled
        Given normals ``(H, W, 3)`` and albedo ``(H, W)``.
    lights, mask, points_mm, camera, depth_sigma, noise, on_progress
        As in `normal_uncertainty`.
    keep_reference
        Whether to return the normals of the reference.
    estimated
        The law of images without a known one, if it was estimated before.
    """
    pixels = np.flatnonzero(mask)
    solver = _Solver(stack, lights, mask, scaled, points_mm, camera, depth_sigma)
    law = None if noise is None else NoiseLaw(noise, (len(stack), *mask.shape))
    origin: Origin = "residuals" if noise is None else cast(Origin, noise.origin)
    fitted = None
    if law is None:
        fitted = solver.law_of_images(mask) if estimated is None else estimated.law
        origin = "unknown" if fitted is None else origin
    counts = np.zeros((len(SampleKind), mask.size), np.uint8 if len(stack) < 256 else np.uint16)
    reason = np.zeros(mask.size, np.uint8)
    parts = np.zeros((9, mask.size), np.float32)
    reference = np.zeros((mask.size, 3), np.float32) if keep_reference else None
    done = 0
    for block in _blocks(pixels, mask.shape[1]):
        samples, vectors = solver.model.samples(Frames(stack), block)
        known = fitted if law is None else law.of(block, samples, vectors)
        _, of_block, results = solver.solve(block, samples, vectors, known)
        counts[:, block] = of_block.T
        good = np.isfinite(results[:, NOISE])
        reason[block] = _reasons(of_block, good, scaled[1].flat[block] > 0)
        parts[:, block[good]] = results[good, VARIANCES].T
        if reference is not None:
            found = results[good, REFERENCE]
            reference[block[good]] = found / np.linalg.norm(found, axis=1, keepdims=True)
        done += len(block)
        on_progress("error bars", done, len(pixels))
    of_noise, of_lights, height, difference, *residuals = parts.reshape(-1, *mask.shape)
    chi2, free, *_ = residuals
    factor = agreement(chi2, free)
    model, common_model, kept = model_errors(of_noise, of_lights, *residuals)
    if noise is not None:
        np.maximum(factor, 1, out=factor)
    return PixelVariances(
        of_noise * factor,
        of_lights * factor,
        height,
        model,
        common_model,
        difference,
        kept,
        None if reference is None else reference.reshape(*mask.shape, 3),
        counts.reshape(-1, *mask.shape),
        reason.reshape(mask.shape),
        origin,
        solver.correlation(pixels, fitted, law),
    )


def kinds_of(
    stack: Float,
    lights: Lights,
    mask: Mask,
    stereo: PhotometricStereoResult,
    points_mm: npt.NDArray[np.float64] | None,
    noise: StackNoise | None,
) -> npt.NDArray[np.uint8]:
    """Return the kind of every sample, ``(N, H, W)``; 0 outside the mask."""
    stack = np.ascontiguousarray(stack, np.float32)
    scaled = stereo.normal_map.normals, stereo.albedo
    solver = _Solver(stack, lights, mask, scaled, points_mm, None, 0.0)
    pixels = np.flatnonzero(mask)
    samples, vectors = solver.model.samples(Frames(stack), pixels)
    if noise is None:
        law = solver.law_of_images(mask)
    else:
        law = NoiseLaw(noise, (len(stack), *mask.shape)).of(pixels, samples, vectors)
    whole = np.zeros((len(stack), mask.size), np.uint8)
    whole[:, pixels] = solver.solve(pixels, samples, vectors, law)[0].T
    return whole.reshape(stack.shape)


class _Solver:
    """Solves blocks of pixels."""

    def __init__(
        self,
        stack: Float,
        lights: Lights,
        mask: Mask,
        scaled: tuple[Float, Float],
        points_mm: npt.NDArray[np.float64] | None,
        camera: CameraModel | None,
        depth_sigma: float,
    ) -> None:
        self.model = LightModel(lights, points_mm, mask)
        self._stack, self._width = stack, mask.shape[1]
        self._near = lights.near
        self._table = light_table(lights)
        self._normals, self._albedo = scaled[0].reshape(-1, 3), scaled[1].reshape(-1)
        self._points = np.zeros((1, 3))
        if points_mm is not None and lights.near:
            self._points = np.asarray(points_mm, np.float64).reshape(-1, 3)
        self._view = np.zeros(4)
        if camera is not None and lights.near:
            self._view[:] = *camera.centre_mm, depth_sigma
        self._errors = bool(self._table[ERRORS].any() or self._view[3] > 0)

    def _points_of(self, pixels: npt.NDArray[np.intp]) -> Double:
        return self._points[pixels] if self._near else self._points

    def solve(
        self, pixels: npt.NDArray[np.intp], samples: Float, vectors: Float, law: Float | None
    ) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.int64], Double]:
        """Return the kinds ``(P, N)``, their numbers, and the results of some pixels.

        Without a law, all samples have the same unknown variance.
        """
        kinds = np.zeros(samples.shape, np.uint8)
        counts = np.zeros((len(pixels), len(SampleKind)), np.int64)
        results = np.zeros((len(pixels), RESULTS))
        wide = np.zeros((1, 2, samples.shape[1]), np.float32)
        wide[:, 0] = 1
        if law is not None:
            wide = np.broadcast_to(law, (len(law), 2, samples.shape[1]))
            # A kernel is compiled again for arrays that cannot be written.
            wide = np.require(law if law.shape == wide.shape else wide, requirements=("C", "W"))
        starts = _row_starts(pixels, self._width)
        in_threads(
            reference_solutions,
            len(starts) - 1,
            samples,
            vectors,
            wide,
            (self._normals[pixels] * self._albedo[pixels, None]).astype(np.float64),
            np.float32(_LEAST_SCALE if law is None else 1.0),
            self._table,
            self._errors and law is not None,
            self._near,
            self._points_of(pixels),
            self._view,
            pixels,
            starts,
            kinds,
            counts,
            results,
        )
        return kinds, counts, results

    def correlation(
        self, pixels: npt.NDArray[np.intp], fitted: Float | None, law: NoiseLaw | None
    ) -> float:
        """Return how alike the residuals of neighbouring lights are at some pixels."""
        some = pixels[:: max(1, len(pixels) // _SAMPLED)]
        samples, vectors = self.model.samples(Frames(self._stack), some)
        known = fitted if law is None else law.of(some, samples, vectors)
        kinds, _, results = self.solve(some, samples, vectors, known)
        return neighbour_correlation(samples, vectors, kinds, results)

    def law_of_images(self, mask: Mask) -> Float | None:
        """Return the law of the noise that the images show; None if they are too few or small."""
        law = law_of_images(Frames(self._stack), self.model, mask)
        return law_of_errors(law, len(self._stack), int(np.count_nonzero(mask)))


def law_of_errors(law: Float | None, images: int, pixels: int) -> Float | None:
    """Return the law that `law_of_images` found; no noise if many pixels showed none."""
    enough = images >= _FEWEST_IMAGES and pixels >= _FEWEST_PIXELS
    return np.zeros((1, 2, 1), np.float32) if law is None and enough else law


def _row_starts(pixels: npt.NDArray[np.intp], width: int) -> npt.NDArray[np.intp]:
    """Return where rows of the image begin in a list of pixels, and its length."""
    inside = np.flatnonzero(np.diff(pixels // width)) + 1
    return np.concatenate([[0], inside, [len(pixels)]]).astype(np.intp)


def _blocks(pixels: npt.NDArray[np.intp], width: int) -> Iterator[npt.NDArray[np.intp]]:
    """Yield complete rows of pixels, about `_BLOCK` at once."""
    starts = _row_starts(pixels, width)
    at = np.unique(np.searchsorted(starts, np.arange(0, len(pixels) + _BLOCK, _BLOCK)))
    chosen = starts[np.minimum(at, len(starts) - 1)]
    for first, last in pairwise(chosen):
        if last > first:
            yield pixels[first:last]


def _reasons(counts: npt.NDArray[np.int64], good: Mask, solved: Mask) -> npt.NDArray[np.uint8]:
    if good.all():
        return np.full(len(good), Reason.VALID, np.uint8)
    lit, attached, cast, saturated, outlier, missing = counts.T
    lost = np.stack([saturated + missing, attached + cast, outlier])
    few = np.array([Reason.SATURATED, Reason.SHADOW, Reason.OUTLIERS])[np.argmax(lost, axis=0)]
    reason = np.where(lit < 3, few, Reason.COPLANAR)
    unsolved = np.where(lit + attached + cast + outlier < 3, Reason.SATURATED, Reason.UNSOLVED)
    reason = np.where(solved, reason, unsolved)
    return np.where(good, Reason.VALID, reason).astype(np.uint8)
