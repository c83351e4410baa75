"""Shifts of the images of a recording against each other, to hundredths of a pixel."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from calibration import EstimateError
from calibration.radiance import structure_shifts
from processing.images.block_means import block_mean
from processing.images.recorded_images import Images
from processing.registration.shift_fit import MARGIN, Patches, first_look, fit_shifts
from rig.arrays import Bool, Float32, Float64, Intp
from rig.messages import short_repr

# Blocks of the first stage, along a side of the object, at most; the fewest in its coarsest level.
_BLOCKS: Final = 220
_FEWEST: Final = 14
# Parts of the images in full resolution, and their size in pixels.
_TILES: Final = 40
_TILE_PX: Final = (12, 40)
# Fewest pixels of these parts that count, also of many images.
_TILE_PIXELS: Final = 12_000
# Blocks around the object that show its outline.
_OUTLINE: Final = 12
_BESIDE_SHADOWS: Final = 5
_STEPS: Final = (12, 6)
# Largest step at a coarse scale, in its pixels, of images that stand still.
_STILL: Final = 0.2
# Share by which shifts of a pixel or more must lower the cost, and smaller ones in proportion. Real
# ones lower it more (0.5 for 1 px, 0.13 for 0.25 px); those that errors of lights, curve or room
# light imitate less (0.22 for 2.7 px, 0.13 for 0.56 px).
_LEAST_GAIN: Final = 0.3
# Error of shifts where the model explains nothing, and the least share that it must explain: on a
# bare hemisphere 0.2 px and 0.43, on objects with structure up to 0.03 px and from 0.7 on.
_BIAS_PX: Final = 0.4
_LEAST_EXPLAINED: Final = 0.45
_LEAST_CONTRAST: Final = 0.02
# Largest credible shift, as a share of the size of the object: false matches are larger.
_MOST_SHIFT: Final = 1 / 4
# Fewer images or pixels determine no shifts.
_FEWEST_IMAGES: Final = 5
_FEWEST_PIXELS: Final = 150

VectorsAt = Callable[[Float64, Float64], Float64]


@dataclass(frozen=True, eq=False)
class ImageShifts:
    """Shifts of N images.

    Parameters
    ----------
    shifts_px
        ``(N, 2)``: by how much the object is further right and down in an image, against the median
        of all images.
    sigma_px
        ``(N, 2)`` their standard deviations, from the scatter between parts of the object and from
        what the model leaves.
    explained
        Share of the fine structure that the model explains. Below about 0.45, the images show too
        little structure besides shadows and highlights, and the shifts are not determined.
    contrast
        Fine structure of the object relative to the light. Smooth objects have below 0.02.
    gain
        Share by which the shifts lower the cost of the fit (a robust sum of squares of what the
        model leaves): about 0 if nothing moved, or if errors of the model imitate shifts.
    size_px
        Size of the object.
    """

    shifts_px: Float64
    sigma_px: Float64
    explained: float
    contrast: float
    gain: float
    size_px: float

    __repr__ = short_repr

    @property
    def largest_px(self) -> float:
        """The largest distance from the median position."""
        return float(np.hypot(*self.shifts_px.T).max())

    @property
    def determined(self) -> bool:
        """Whether the images show enough structure, and the shifts are not suspiciously large."""
        structured = self.explained > _LEAST_EXPLAINED and self.contrast > _LEAST_CONTRAST
        return structured and self.largest_px < _MOST_SHIFT * self.size_px

    @property
    def real(self) -> bool:
        """Whether the shifts lower the cost as much as those of images that moved."""
        return _real(self.gain, self.largest_px)

    def significant(self, least_px: float) -> Bool:
        """Return which images are shifted by more than a distance, and surely."""
        distance, sigma = np.hypot(*self.shifts_px.T), np.hypot(*self.sigma_px.T)
        return np.asarray((distance > least_px) & (distance > 3 * sigma))


def find_image_shifts(
    images: Images, mask: Bool, vectors_at: VectorsAt, least_px: float = 0.0
) -> ImageShifts:
    """Find the shifts of images of one object under different lights.

    The model is a matte surface with any albedo and normals (`processing.registration.shift_fit`);
    only structure finer than some pixels counts, so that lights, curve and reflectance need not be
    exact. Shifts of up to a tenth of the size of the object are found, from coarse to fine.

    Parameters
    ----------
    images
        N images ``(H, W)``, linear radiance divided by the intensities of the lights, NaN where
        missing; at least 5.
    mask
        ``(H, W)`` bool, the object.
    vectors_at
        Returns light vectors ``(P, N, 3)`` at rows and columns ``(P,)``.
    least_px
        Smallest shift of interest: if a first look, which takes a tenth of the time, shows none at
        any scale, all shifts are 0.

    Raises
    ------
    EstimateError
        If there are too few images, or the object is too small.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.registration import find_image_shifts
    >>> rng = np.random.default_rng(1)
    >>> paint = np.pad(rng.uniform(0.2, 1, (80, 80)).astype(np.float32), 20)
    >>> lights = np.array([[1, 0, 2], [0, 1, 2], [-1, 0, 2], [0, -1, 2], [0, 0, 2.2]]) / 2.2
    >>> images = [paint * light[2] for light in lights]
    >>> images[3] = np.roll(images[3], 2, axis=1)
    >>> at = lambda rows, columns: np.broadcast_to(lights, (len(rows), 5, 3))
    >>> found = find_image_shifts(images, paint > 0, at)
    >>> found.shifts_px[3].round(1) + 0.0
    array([2., 0.])
    """
    count, area = len(images), int(np.count_nonzero(mask))
    if count < _FEWEST_IMAGES or area < _FEWEST_PIXELS:
        raise EstimateError(
            f"{count} images with {area} pixels of the object: {_FEWEST_IMAGES} images and "
            f"{_FEWEST_PIXELS} pixels are needed to find shifts"
        )
    first = max(1, math.ceil(math.sqrt(area) / _BLOCKS))
    blocks = [_reduced(np.asarray(image, np.float32), first) for image in images]
    inside = _reduced(mask.astype(np.float32), first) > 0.999
    # The outline moves with the object, and distinguishes the periods of a pattern.
    outline = np.asarray(
        cv2.dilate(inside.astype(np.float32), np.ones((3, 3)), iterations=_OUTLINE), np.float32
    )
    coarsest = 1
    while math.sqrt(inside.sum()) / (2 * coarsest) >= _FEWEST:
        coarsest *= 2

    def level(size: int) -> Patches:
        values = np.stack([_reduced(block, size) for block in blocks])
        counts = _reduced(outline, size) > 0.999
        return _complete(values, counts, vectors_at, first * size)

    side, still = int(np.clip(math.sqrt(area) / 4, *_TILE_PX)), np.zeros((count, 2))
    corners = _corners(np.stack(blocks), inside, first, side)
    if len(corners) == 0:
        raise EstimateError("the object is too thin to find shifts of its images")
    if least_px > 0:
        tiles = _tiles_of(images, mask, corners, side, still, vectors_at)
        scales = [(level(coarsest >> n), _STILL) for n in range(coarsest.bit_length())]
        if not any(_moves(*one) for one in [*scales, (tiles, least_px)]):
            return ImageShifts(still, np.full((count, 2), least_px), 1.0, 1.0, 0.0, math.sqrt(area))
    by_energy = structure_shifts(blocks) * first
    shifts, size = by_energy, coarsest
    while size >= 1:
        # Repeated structure may mislead the level before: other starts compete with it.
        step = first * size
        starts = [still, shifts / step, by_energy / step]
        shifts = fit_shifts(level(size), starts, _STEPS[0]).shifts * step
        size //= 2
    shifts -= np.median(shifts, axis=0)
    whole = np.rint(shifts)
    patches = _tiles_of(images, mask, corners, side, whole, vectors_at)
    fit = fit_shifts(patches, [shifts - whole], _STEPS[1], _TILE_PIXELS)
    shifts = whole + fit.shifts
    by_model = _BIAS_PX * (1 - fit.explained) ** 2
    sigma = np.sqrt(np.maximum(np.diag(fit.covariance), 0) + by_model**2).reshape(count, 2)
    return ImageShifts(
        shifts - np.median(shifts, axis=0),
        sigma,
        fit.explained,
        fit.contrast,
        fit.gain(_tiles_of(images, mask, corners, side, still, vectors_at)),
        math.sqrt(area),
    )


def _moves(patches: Patches, least: float) -> bool:
    """Return whether a first look shows steps above the least one, in pixels of the patches."""
    look = first_look(patches)
    step = float(np.abs(look.step).max())
    return step > least and _real(look.gain, step)


def _real(gain: float, largest_px: float) -> bool:
    return gain > _LEAST_GAIN * min(1.0, largest_px)


def _reduced(image: Float32, size: int) -> Float32:
    """Return the means over blocks; the rest at the right and lower border is left out."""
    rows, columns = (length // size * size for length in image.shape)
    return block_mean(np.ascontiguousarray(image[:rows, :columns]), size)


def _complete(values: Float32, inside: Bool, vectors_at: VectorsAt, size: int) -> Patches:
    """Return complete images, whose pixels are as large as ``size`` pixels, as patches."""

    def vectors(pixels: Intp) -> Float64:
        rows, columns = np.divmod(pixels, inside.shape[1])
        middle = (size - 1) / 2
        return vectors_at(rows * size + middle, columns * size + middle)

    return Patches(values[:, None], inside[None], vectors, size)


def _corners(blocks: Float32, inside: Bool, size: int, side: int) -> Intp:
    """Return the first row and column ``(T, 2)`` of the tiles with most structure both ways."""
    known = np.nan_to_num(blocks)
    rows, columns = inside.shape
    wide = max(1, side // size)
    scores = []
    for top in range(0, rows - wide + 1, wide):
        for left in range(0, columns - wide + 1, wide):
            if inside[top : top + wide, left : left + wide].mean() < 0.5:
                continue
            part = known[:, top : top + wide, left : left + wide]
            if wide < 2:
                scores.append((float(part.std()), top, left))
                continue
            right, down = np.diff(part, axis=2), np.diff(part, axis=1)
            least = min(float((right**2).mean()), float((down**2).mean()))
            scores.append((least, top, left))
    best = sorted(scores, reverse=True)[:_TILES]
    return np.array([(top * size, left * size) for _, top, left in best], np.intp).reshape(-1, 2)


def _tiles_of(
    images: Images, mask: Bool, corners: Intp, core: int, whole: Float64, vectors_at: VectorsAt
) -> Patches:
    """Return tiles of all images in full resolution, moved back by whole pixels."""
    side = core + 2 * MARGIN
    values = np.full((len(images), len(corners), side, side), np.nan, np.float32)
    inside = np.zeros((len(corners), side, side), bool)
    middle = slice(MARGIN, MARGIN + core)
    for t, (top, left) in enumerate(corners):
        part = mask[top : top + core, left : left + core]
        inside[t, middle, middle][: part.shape[0], : part.shape[1]] = part
    for k, image in enumerate(images):
        right, down = whole[k].astype(int).tolist()
        for t, (top, left) in enumerate(corners):
            values[k, t] = _window(image, top - MARGIN + down, left - MARGIN + right, side)
    inside &= np.isfinite(values).all(axis=0)

    def vectors(pixels: Intp) -> Float64:
        tile, rest = np.divmod(pixels, side * side)
        rows, columns = np.divmod(rest, side)
        return vectors_at(corners[tile, 0] + rows - MARGIN, corners[tile, 1] + columns - MARGIN)

    return Patches(values, inside, vectors, 1, beside_shadows=_BESIDE_SHADOWS)


def _window(image: Float32, top: int, left: int, side: int) -> Float32:
    """Return a square part of an image, NaN outside it."""
    part = np.full((side, side), np.nan, np.float32)
    height, width = image.shape
    rows = slice(min(max(0, top), height), min(max(0, top + side), height))
    columns = slice(min(max(0, left), width), min(max(0, left + side), width))
    part[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left] = image[
        rows, columns
    ]
    return part
