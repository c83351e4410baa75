"""Reference solutions of all pixels of an image, with their variances."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, cast

import numpy as np

from acquisition import CameraModel, Lights
from calibration import StackNoise
from processing.noise.around import sum_around
from processing.noise.reference import PARTS
from processing.noise.reference_solver import ReferenceSolver, row_blocks
from processing.noise.sample_kind import Reason, SampleKind
from processing.stereo.frames import Frames
from processing.stereo.image_noise import NoiseLaw, law_of_images
from processing.stereo.light_model import LightModel
from rig import Progress, no_progress, short_repr
from rig.arrays import Bool, Float32, Float64, Intp, UInt8, UInt16

Counts = UInt8 | UInt16

# Sums over this many pixels across, drawn toward 1 by a few degrees of freedom.
_ACROSS = 5
_PRIOR = 50.0
# Residuals are not noise beyond this many standard deviations of their mean square; they count
# completely from twice as many on, so that the error has no step at the limit.
_SIGMAS = 4.0
# Variance of the normal relative to N times that of independent residuals, and share of the mean
# deviation of the object that every pixel has besides its own: from simulated materials.
_COHERENT = 1.6
_COMMON = 0.7
# The same of deviations that only the mean over the object shows: those of rough surfaces are so
# broad that most of them turns normals and leaves no residual. No more than this many standard
# deviations of the noise; larger ones show in each pixel.
_BROAD = 6.0
_HIDDEN = 2.0
# Power of the share that a reflectance leaves.
_LEFT = 3
# Columns of `row_sums`.
SUMS = 7
# Share of the variance of `common_error` by which all normals turn alike: on simulated objects, the
# mean of the errors by a rough surface is a third of their root mean square.
ALIKE = 1 / 9
# Mean square angle between any direction and one that is uniform on the sphere, rad^2. No direction
# is less certain; to first order, variances have no limit.
UNIFORM = (math.pi**2 - 4) / 2
# Where a law of the noise is from.
Origin = Literal["sensor", "repeats", "residuals", "unknown"]
# Pixels whose residuals show whether they are noise.
_SAMPLED = 4000
# Fewest images and pixels whose differences show that there is no noise.
_FEWEST_IMAGES = 5
_FEWEST_PIXELS = 100


@dataclass(frozen=True, eq=False, kw_only=True)
class SolvedStack:
    """Images of an object with their solution.

    Parameters
    ----------
    values
        ``(N, H, W)``, or ``(N, H, W, 3)`` in colour.
    lights, mask, points_mm, camera, depth_sigma, noise
        As in `normal_uncertainty`.
    normals, albedo
        Given normals ``(H, W, 3)``, and albedo ``(H, W)``, or ``(H, W, 3)`` in colour.
    """

    values: Float32
    lights: Lights
    mask: Bool
    normals: Float32
    albedo: Float32
    points_mm: Float64 | None = None
    camera: CameraModel | None = None
    depth_sigma: float = 0.0
    noise: StackNoise | None = None

    def of_colours(self) -> list[SolvedStack]:
        """Return the channels of images in colour."""
        return [
            replace(
                self,
                values=np.ascontiguousarray(self.values[..., channel]),
                albedo=np.ascontiguousarray(self.albedo[..., channel]),
                noise=None if self.noise is None else self.noise.of_colour(channel),
            )
            for channel in range(self.values.shape[-1])
        ]

    @cached_property
    def frames(self) -> Frames:
        """The images as the compiled solvers read them."""
        return Frames(self.values)

    @cached_property
    def model(self) -> LightModel:
        """The light vectors at the pixels."""
        return LightModel(self.lights, self.points_mm, self.mask)

    @cached_property
    def law(self) -> NoiseLaw | None:
        """The law of the noise; None if it is unknown."""
        if self.noise is None:
            return None
        return NoiseLaw(self.noise, (len(self.values), *self.mask.shape))

    def solver(self) -> ReferenceSolver:
        """Return what solves the pixels again."""
        scaled = self.normals, self.albedo
        return ReferenceSolver(self.lights, scaled, self.points_mm, self.camera, self.depth_sigma)

    def fitted_law(self) -> Float32 | None:
        """Return the law that the images show if none is known, see `law_of_errors`."""
        if self.law is not None:
            return None
        found = law_of_images(self.frames, self.model, self.mask)
        return law_of_errors(found, len(self.values), int(np.count_nonzero(self.mask)))

    def samples(
        self, pixels: Intp, fitted: Float32 | None
    ) -> tuple[Float32, Float32, Float32 | None]:
        """Return the samples of some pixels, their light vectors, and the law of their noise."""
        samples, vectors = self.model.samples(self.frames, pixels)
        law = fitted if self.law is None else self.law.of(pixels, samples, vectors)
        return samples, vectors, law


@dataclass(frozen=True, eq=False)
class PixelVariances:
    """Reference solutions and their variances in rad^2.

    Parameters
    ----------
    noise, lights, height
        ``(H, W)`` variances of the direction of the reference by the noise, the errors of the
        lights, and that of the mean height. Noise and lights are scaled by the agreement of the
        residuals with them.
    model
        ``(H, W)`` variances where the surface is not matte, see `model_errors`.
    sums
        ``(H, SUMS)`` sums over rows, which show what all pixels have of them, see `row_sums`.
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
        See `ReferenceSolver.correlation`.
    """

    noise: Float32
    lights: Float32
    height: Float32
    model: Float32
    sums: Float64
    difference: Float32
    kept: Float32
    reference: Float32 | None
    samples: Counts
    reason: UInt8
    origin: Origin
    correlation: float

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class Shown:
    """What some pixels of images show.

    Parameters
    ----------
    law
        Law of the noise, ``(1, 2, N)``, if none is given; None if they do not show it either.
    correlation
        See `ReferenceSolver.correlation`.
    """

    law: Float32 | None
    correlation: float


class VarianceMaps:
    """Variances of the pixels of an image, block by block.

    Parameters
    ----------
    solver
        Solves the pixels.
    albedo
        Albedo ``(H, W)`` of the given normals.
    lights
        Number of lights.
    origin
        Where the law of the noise is from.
    keep_reference
        Whether to keep the normals of the reference.
    """

    def __init__(
        self,
        solver: ReferenceSolver,
        albedo: Float32,
        lights: int,
        origin: Origin,
        *,
        keep_reference: bool = False,
    ) -> None:
        self._solver, self._albedo, self._origin = solver, albedo, origin
        size = albedo.size
        self._counts = np.zeros((len(SampleKind), size), np.uint8 if lights < 256 else np.uint16)
        self._reason = np.zeros(size, np.uint8)
        self._parts = np.zeros((PARTS, size), np.float32)
        self._reference = np.zeros((size, 3), np.float32) if keep_reference else None

    def add(self, pixels: Intp, samples: Float32, vectors: Float32, law: Float32 | None) -> None:
        """Solve complete rows of pixels."""
        _, counts, found, parts = self._solver.solve(
            pixels, samples, vectors, law, keep_kinds=False
        )
        good = np.isfinite(found[:, 0])
        at = place_of(pixels)
        self._counts[:, at] = counts.T
        self._reason[at] = _reasons(counts, good, self._albedo.reshape(-1)[at] > 0)
        self._parts[:, at] = parts.T
        if self._reference is not None:
            unit = found[good] / np.linalg.norm(found[good], axis=1, keepdims=True)
            self._reference[pixels[good]] = unit

    def variances(self, correlation: float) -> PixelVariances:
        """Return the variances; see `PixelVariances` for the correlation."""
        shape = self._albedo.shape
        of_noise, of_lights, height, difference, *residuals = self._parts.reshape(-1, *shape)
        chi2, free, *_ = residuals
        factor = _agreement(chi2, free)
        model, kept = model_errors(of_noise, of_lights, *residuals)
        if self._origin in ("sensor", "repeats"):
            np.maximum(factor, 1, out=factor)
        return PixelVariances(
            of_noise * factor,
            of_lights * factor,
            height,
            model,
            row_sums(model, of_noise, of_lights, residuals),
            difference,
            kept,
            None if self._reference is None else self._reference.reshape(*shape, 3),
            self._counts.reshape(-1, *shape),
            self._reason.reshape(shape),
            self._origin,
            correlation,
        )


def pixel_variances(
    given: SolvedStack,
    *,
    shown: Shown | None = None,
    keep_reference: bool = False,
    on_progress: Progress = no_progress,
) -> PixelVariances:
    """Solve all pixels of a gray stack again.

    Parameters
    ----------
    given
        The stack and its solution.
    shown
        What other pixels of the same images show; default: what these pixels show.
    keep_reference
        Whether to return the normals of the reference.
    on_progress
        As in `normal_uncertainty`.
    """
    pixels, width = np.flatnonzero(given.mask), given.mask.shape[1]
    if shown is None:
        shown = shown_by(given)
    origin, lights = origin_of(given.noise, shown.law), len(given.values)
    maps = VarianceMaps(given.solver(), given.albedo, lights, origin, keep_reference=keep_reference)
    done = 0
    for block in row_blocks(pixels, width):
        maps.add(block, *given.samples(block, shown.law))
        done += len(block)
        on_progress("error bars", done, len(pixels))
    return maps.variances(shown.correlation)


def shown_by(given: SolvedStack) -> Shown:
    """Return what the pixels of a gray stack show; only those of `some_of` need normals."""
    fitted, some = given.fitted_law(), some_of(np.flatnonzero(given.mask))
    correlation = given.solver().correlation(some, *given.samples(some, fitted))
    return Shown(fitted, correlation)


def place_of(pixels: Intp) -> slice | Intp:
    """Return increasing indices, as a slice if none is left out: it is written faster."""
    whole = pixels[-1] - pixels[0] + 1 == len(pixels)
    return slice(int(pixels[0]), int(pixels[-1]) + 1) if whole else pixels


def some_of(pixels: Intp) -> Intp:
    """Return about 4,000 of the pixels, whose residuals show whether they are noise."""
    return pixels[:: max(1, len(pixels) // _SAMPLED)]


def origin_of(noise: StackNoise | None, estimated: Float32 | None) -> Origin:
    """Return where the law of the noise is from."""
    if noise is not None:
        return cast(Origin, noise.origin)
    return "unknown" if estimated is None else "residuals"


def law_of_errors(law: Float32 | None, images: int, pixels: int) -> Float32 | None:
    """Return the law that `law_of_images` found; no noise if many pixels showed none."""
    enough = images >= _FEWEST_IMAGES and pixels >= _FEWEST_PIXELS
    return np.zeros((1, 2, 1), np.float32) if law is None and enough else law


def _reasons(counts: UInt16, good: Bool, solved: Bool) -> UInt8:
    if good.all():
        return np.full(len(good), Reason.VALID, np.uint8)
    lit, attached, in_cast, saturated, outlier, missing = counts.T
    lost = np.stack([saturated + missing, attached + in_cast, outlier])
    few = np.array([Reason.SATURATED, Reason.SHADOW, Reason.OUTLIERS])[np.argmax(lost, axis=0)]
    reason = np.where(lit < 3, few, Reason.COPLANAR)
    unsolved = np.where(lit + attached + in_cast + outlier < 3, Reason.SATURATED, Reason.UNSOLVED)
    reason = np.where(solved, reason, unsolved)
    return np.where(good, Reason.VALID, reason).astype(np.uint8)


def _agreement(chi2: Float32, free: Float32) -> Float32:
    """Return the mean square of normalised residuals around each pixel, ``(H, W)``.

    Parameters
    ----------
    chi2, free
        ``(H, W)`` sums of squares and their degrees of freedom, 0 without residuals.
    """
    return np.asarray(
        (sum_around(chi2, _ACROSS) + _PRIOR) / (sum_around(free, _ACROSS) + _PRIOR), np.float32
    )


def model_errors(
    noise: Float32,
    lights: Float32,
    chi2: Float32,
    free: Float32,
    left: Float32,
    products: Float32,
    paired: Float32,
) -> tuple[Float32, Float32]:
    """Return variances by the model, and the share of differences that are errors.

    Noise is independent from pixel to pixel and from light to light, and N lights average it. Where
    the surface is not matte, residuals of neighbouring pixels are alike: the mean of their products
    is the variance of the deviation from a matte surface. Such deviations are also alike for
    neighbouring lights, and many lights do not average them: their effect on the normal is about N
    times that of independent residuals of this size. Normals that a reflectance explains better
    than the reference have a smaller error; it falls with what the reflectance leaves. The factors
    are measured on simulated materials.

    Parameters
    ----------
    noise, lights
        ``(H, W)`` variances by noise and lights, 0 where there is no solution.
    chi2, free
        Sums of squares of the normalised residuals of the reference, and degrees of freedom.
    left
        Sums of squares that a reflectance at the given normal leaves.
    products, paired
        Sums of products of the residuals with those of a neighbour, and their degrees of freedom, 0
        without a neighbour.
    """
    total = noise + lights
    solved = total > 0
    share = np.divide(lights, total, out=np.zeros_like(total), where=solved)
    pairs = sum_around(paired, _ACROSS)
    # Errors of the lights are the same in all pixels.
    spread = 1 / np.sqrt(np.maximum(pairs, 1)) + share * np.sqrt(2 / np.maximum(free, 1))
    alike = np.divide(
        sum_around(products, _ACROSS), pairs, out=np.zeros_like(total), where=pairs > 0
    )
    excess = alike - share
    excess *= np.clip(excess / (_SIGMAS * spread) - 1, np.float32(0), np.float32(1))
    explained = np.minimum(_agreement(left, free) / _agreement(chi2, free), 1)
    kept = np.where(excess > 0, explained, np.float32(1)) ** _LEFT
    own = np.sqrt(_COHERENT * kept * excess * total * (free + 3))
    return np.asarray(own**2, np.float32), np.asarray(kept, np.float32)


def row_sums(
    model: Float32, noise: Float32, lights: Float32, residuals: Sequence[Float32]
) -> Float64:
    """Return sums over rows ``(H, SUMS)`` for `common_error`.

    They are the standard deviations of the model, pixels with a solution, logarithms of their
    variances by noise and lights, the share of the lights, degrees of freedom, products of
    neighbours and their degrees of freedom. Variances of pixels that lights hardly determine have
    no limit: the typical one is a geometric mean.

    Parameters
    ----------
    model
        ``(H, W)`` variances of `model_errors`.
    noise, lights, residuals
        The arguments of `model_errors`, all of them.
    """
    _, free, _, products, paired = residuals
    total = noise + lights
    solved = total > 0
    known = np.where(solved, total, 1)
    own = np.sqrt(np.minimum(model, np.float32(UNIFORM)))
    parts = own, solved, np.log(known), lights / known, free, products, paired
    return np.stack([part.sum(axis=1, dtype=np.float64) for part in parts], axis=1)


def common_error(sums: Float64) -> float:
    """Return the variance that every pixel has besides its own, from all rows of `row_sums`.

    It is from the mean deviation of the object, because the part of a broad highlight that is
    linear in the direction of the light turns normals and leaves no residual. Deviations below the
    noise of a pixel show in the mean product of all neighbours.
    """
    own, pixels, logarithms, lights, free, products, paired = sums.sum(axis=0)
    if not pixels:
        return 0.0
    shown = (_COMMON * own / pixels) ** 2
    if not paired:
        return float(shown)
    share = lights / pixels
    spread = 1 / math.sqrt(paired) + share * math.sqrt(2 * pixels / free)
    excess = products / paired - share
    excess *= min(max(excess / (_SIGMAS * spread) - 1, 0.0), 1.0)
    hidden = math.exp(logarithms / pixels) * min(_BROAD * excess * (free / pixels + 3), _HIDDEN**2)
    return float(max(shown, hidden))
