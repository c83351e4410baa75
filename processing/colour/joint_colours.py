"""One normal from all colours of images: every light gives one sample with the least variance."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
import numpy.typing as npt

from acquisition.files import rows_in_bands
from calibration import StackNoise
from calibration.radiance import luma
from processing.colour.channel_normals import ColourImages, ColourMaps
from processing.stereo.frames import Frames
from processing.stereo.image_noise import NoiseLaw, law_of_images
from processing.stereo.light_model import LightModel
from processing.stereo.method import Method
from processing.stereo.stereo_maps import StereoMaps
from rig.arrays import AnyArray, Bool, Float32, Float64, Floating

_ROWS = 64
# Residuals of noiseless images are rounding errors of about this size, relative to the albedo.
_ROUNDING = 1e-5
# Smaller variances are those of samples without noise, which all weigh alike.
_LEAST = 1e-20
# Lights with a smaller share of the light of a pixel do not show its colour.
_DARK = 0.1
# A sample is weak if its measured colours have less than this share of the information of all
# colours. Methods that order samples without regard to their noise use it only if there are fewer
# others than this.
_WEAK = 0.1
_ENOUGH: dict[Method, int] = {"trimmed": 8, "best": 16}


def _over_colours(values: AnyArray) -> AnyArray:
    """Return the sums over the last axis, of length 3; `numpy.sum` takes ten times as long."""
    return np.asarray(values[..., 0] + values[..., 1] + values[..., 2])


@dataclass(frozen=True, eq=False, repr=False)
class JointNoise(StackNoise):
    """Law of the noise of combined samples: the reciprocal of the sum of the precisions.

    Parameters
    ----------
    colours
        ``(H, W, 3)`` colours with which the samples were combined.
    values
        ``(N, H, W, 3)`` the stack, which says which of its samples were measured.
    """

    colours: Float32 = field(default_factory=lambda: np.zeros((0, 0, 3), np.float32))
    values: Float32 = field(default_factory=lambda: np.zeros((0, 0, 0, 3), np.float32))

    @classmethod
    def of(cls, noise: StackNoise, colours: Float32, values: Float32) -> JointNoise:
        """Return the law of the combined samples of a stack with this noise."""
        return cls(**vars(noise), colours=colours, values=values)

    @property
    def linear(self) -> bool:
        """The shares of the colours change with the signal."""
        return False

    def variance(self, image: int, values: npt.ArrayLike, first_row: int = 0) -> Float64:
        """Return the variance of combined samples ``(R, W)``; see `StackNoise.variance`."""
        signal = np.asarray(values, np.float64)
        rows = slice(first_row, first_row + len(signal))
        colours, measured = self.colours[rows], np.isfinite(self.values[image, rows])
        gray = luma(colours).astype(np.float64)
        shading = np.divide(np.maximum(signal, 0), gray, out=np.zeros_like(gray), where=gray > 0)
        of_colours = super().variance(image, colours * shading[..., None], first_row)
        precision = _over_colours(measured * colours**2 / of_colours)
        # A sample that no colour determines is not there; any variance does for it.
        unseen = np.ones_like(gray)
        return np.asarray(np.divide(gray**2, precision, out=unseen, where=precision > 0))

    def take(self, indices: list[int]) -> Self:
        """Return the law of the images with these indices, in this order."""
        return replace(super().take(indices), values=self.values[indices])

    def rows(self, first: int, last: int) -> Self:
        """Return the law of some rows, see `StackNoise.rows`."""
        return replace(
            super().rows(first, last),
            colours=self.colours[first:last],
            values=self.values[:, first:last],
        )


def law_of_joint_samples(images: ColourImages, method: Method) -> Float32 | None:
    """Return the law of the noise of combined samples, see `law_of_images`, if it is needed."""
    if method == "ls":
        return None
    samples, _ = _combined(images, _ENOUGH.get(method))
    return law_of_images(Frames(samples), images.model, images.mask)


def solve_jointly(images: ColourImages, method: Method, law: Float32 | None) -> ColourMaps:
    """Solve one normal and one albedo per colour from the samples of all colours.

    For a pixel of colours a, light i gives the sample ``luma(a) sum(a v / var) / sum(a^2 / var)``
    over its measured colours v. If the surface is matte, this is the estimate of
    ``luma(a) max(l . n, 0)`` with the least variance (Gauss and Markov), and the method sees no
    difference to gray images. The colours are those that explain the samples best under the
    normals of a first pass. If the noise is unknown, the variance is that of shot noise,
    proportional to the signal of the frame.

    The number of samples is that of lights with at least one colour, and the residual that of the
    combined samples.

    Parameters
    ----------
    images
        The images.
    method
        Method of `photometric_stereo`.
    law
        What `law_of_joint_samples` has returned for these or other rows.
    """
    values, mask, noise, model = images.values, images.mask, images.noise, images.model
    enough = _ENOUGH.get(method)
    samples, colours = _combined(images, enough)
    first = images.solved(samples, law, method)
    known = first.albedo > 0
    intensities = np.asarray(images.lights.intensities)
    for rows in rows_in_bands(len(mask), 1, _ROWS):
        lit = shading(model, first.normals, known, rows)
        found = _colours(values[:, rows], samples[:, rows], lit, first, rows)
        colours[rows] = np.where(known[rows, :, None], found, colours[rows])
        _combine(values, rows, colours, lit, noise, intensities, samples, enough)
    of_samples: NoiseLaw | Float32 | None = law
    if noise is not None:
        of_samples = NoiseLaw(JointNoise.of(noise, colours, values), samples.shape)
    maps = images.solved(samples, of_samples, method)
    scale = _ratio(maps.albedo, luma(colours)).astype(np.float32)
    solved = np.array([maps.albedo.any()])
    albedo = colours * scale[..., None]
    return ColourMaps(maps.normals, albedo, maps.residual, maps.used[None], solved)


def _combined(images: ColourImages, enough: int | None) -> tuple[Float32, Float32]:
    """Return samples ``(N, H, W)`` that are combined with the mean colours, and these."""
    values, mask = images.values, images.mask
    colours = np.zeros((*mask.shape, 3), np.float32)
    intensities = np.asarray(images.lights.intensities)
    samples = np.zeros(values.shape[:3], np.float32)
    for rows in rows_in_bands(len(mask), 1, _ROWS):
        colours[rows] = _mean_colours(values[:, rows])
        _combine(values, rows, colours, None, images.noise, intensities, samples, enough)
    return samples, colours


def _mean_colours(values: Float32) -> Float64:
    """Return the mean colours ``(R, W, 3)``, of the lights that have all colours if they show any.

    Other lights would weight the colours differently. Where one colour is always saturated, the
    lights that have all colours are those in shadow.
    """
    measured = np.isfinite(values)
    complete = measured & measured.all(axis=-1, keepdims=True)
    brightest = np.max(values, axis=-1, keepdims=True, where=measured, initial=0)
    lit = brightest.sum(axis=0, where=complete[..., :1]) > _DARK * brightest.sum(axis=0)
    counted = np.where(lit, complete, measured)
    total = np.sum(values, axis=0, where=counted, dtype=np.float64)
    return _ratio(np.maximum(total, 0), counted.sum(axis=0).astype(np.float64))


def _colours(
    values: Float32, samples: Float32, shades: Float64, first: StereoMaps, rows: slice
) -> Float64:
    """Return the colours ``(R, W, 3)`` that explain the samples of some rows best.

    As in `colour_albedo`, a sample has little weight if it differs from the first solution.
    """
    albedo = first.albedo[rows].astype(np.float64)
    spread = np.maximum(first.residual[rows], albedo * _ROUNDING)
    total, squares = np.zeros((2, *values.shape[1:]))
    for of_light, sample, lit in zip(values, samples, shades, strict=True):
        deviation = _ratio(sample - albedo * lit, spread)
        weight = (lit / (1 + deviation * deviation))[..., None]
        measured = np.isfinite(of_light) & np.isfinite(weight)
        total += np.where(measured, weight * of_light, 0)
        squares += np.where(measured, weight * lit[..., None], 0)
    return _ratio(np.maximum(total, 0), squares)


def _combine(
    values: Float32,
    rows: slice,
    colours: Float32,
    shades: Float64 | None,
    noise: StackNoise | None,
    intensities: Floating,
    samples: Float32,
    enough: int | None,
) -> None:
    """Write the combined samples of some rows; NaN where no colour was measured.

    Without a shading, the variances are those of the measured signals. Weak samples are NaN, too,
    if the pixel has ``enough`` others.
    """
    colour = colours[rows]
    gray = luma(colour)
    weak = np.zeros(samples[:, rows].shape, np.bool_)
    others = np.zeros(gray.shape, np.int64)
    for i, (of_light, out) in enumerate(zip(values[:, rows], samples[:, rows], strict=True)):
        measured = np.isfinite(of_light)
        seen = np.where(measured, of_light, 0)
        if noise is None:
            # The variance of a signal a s is proportional to a s / intensity.
            precision = np.broadcast_to(np.asarray(intensities[i], np.float64), colour.shape)
        else:
            if shades is None:
                lit = _ratio(np.maximum(_over_colours(seen), 0), _over_colours(colour * measured))
            else:
                lit = shades[i]
            variance = noise.variance(i, colour * lit[..., None], rows.start)
            precision = colour / np.maximum(variance, _LEAST)
        weight = np.where(measured, precision, 0)
        scale = _over_colours(weight * colour)
        weak[i] = scale < _WEAK * _over_colours(precision * colour)
        others += (scale > 0) & ~weak[i]
        out[:] = np.where(scale > 0, gray * _ratio(_over_colours(weight * seen), scale), np.nan)
    if enough is not None:
        samples[:, rows][weak & (others >= enough)] = np.nan


def _ratio(above: Floating, below: Floating) -> Float64:
    """Return the quotient, 0 where the divisor is not positive."""
    return np.asarray(np.divide(above, below, out=np.zeros(below.shape), where=below > 0))


def shading(model: LightModel, normals: Float32, mask: Bool, rows: slice) -> Float64:
    """Return ``max(l . n, 0)`` of some rows, ``(N, R, W)``; 0 outside the mask.

    It is 0 too where a near light does not reach the surface.
    """
    inside = mask[rows]
    pixels = np.flatnonzero(inside) + (rows.start or 0) * inside.shape[1]
    vectors = model.vectors(pixels)
    known = normals[rows][inside].astype(np.float64)
    spread = np.broadcast_to(vectors, (len(pixels), *vectors.shape[1:]))
    result = np.zeros((vectors.shape[2], *inside.shape))
    result[:, inside] = np.maximum(np.einsum("pc,pcn->np", known, spread), 0)
    return result
