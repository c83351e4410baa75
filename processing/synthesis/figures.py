"""Quality figures of a synthesised detail component: how far it is from its exemplar."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import fft, ifft, irfft, next_fast_len, rfft

from acquisition import DataError
from processing.maps.mask import bounding_box
from processing.maps.normal_map import NormalMap, check_normal_map
from processing.synthesis.seam_steps import MOST, part_in_middle
from processing.synthesis.spectrum_match import BANDS, band_powers, block_side
from rig.arrays import Float32

# Lags at which fewer pixel pairs of the mask overlap than this share are not judged.
_LEAST_PAIRS = 0.25
# Nor those at which less than this share of the energy overlaps, which could be rounding only.
_LEAST_ENERGY = 0.01
_QUANTILES = 4096
_AT_ONCE = 64


@dataclass(frozen=True, eq=False)
class TextureFigures:
    """Figures of a detail component relative to its exemplar, each computed when first used.

    Of components larger than 2048 x 2048 pixels, the middle is measured.

    Parameters
    ----------
    detail
        The synthesised detail component.
    exemplar
        The detail component it was made from.
    patch
        Side of the patches in pixels, the smallest lag of the repeat scores.
    """

    detail: NormalMap
    exemplar: NormalMap
    patch: int

    def __repr__(self) -> str:
        return f"TextureFigures({self.detail!r}, {self.exemplar!r}, patch={self.patch})"

    @cached_property
    def detail_angle_deg(self) -> float:
        """Mean angle between the detail and z."""
        return _mean_angle_deg(self.detail)

    @cached_property
    def exemplar_angle_deg(self) -> float:
        """The same of the exemplar."""
        return _mean_angle_deg(self.exemplar)

    @cached_property
    def slope_distance(self) -> float:
        """Distance of the slopes of both, relative to the spread of the exemplar's.

        The Wasserstein distance between the distributions of the angle to z, divided by the
        standard deviation of the exemplar's.
        """
        a, b = (_angles_deg(part) for part in (self.detail, self.exemplar))
        spread = float(b.std(dtype=np.float64))
        levels = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
        # Of equally many values each, the mean difference of those of the same rank.
        distance = np.abs(np.quantile(a, levels) - np.quantile(b, levels)).mean()
        return float(distance) / spread if spread else math.nan

    @cached_property
    def spectrum_distance(self) -> float:
        """Mean difference of the log power of both in radial bands of frequency, in nepers."""
        return _spectrum_distance(self.detail, self.exemplar)

    @cached_property
    def exemplar_spectrum_distance(self) -> float:
        """The same between two halves of the exemplar, cut along its longer side."""
        return _spectrum_distance(*_halves(self.exemplar))

    @cached_property
    def repeat_score(self) -> float:
        """Largest normalised autocorrelation at lags of at least a patch; 1 for a repeat."""
        return _repeat_score(self.detail, self.patch)

    @cached_property
    def exemplar_repeat_score(self) -> float:
        """The same of the exemplar; NaN if it is too small for such lags."""
        return _repeat_score(self.exemplar, self.patch)


def texture_figures(detail: NormalMap, exemplar: NormalMap, *, patch: int = 48) -> TextureFigures:
    """Compare a synthesised detail component with its exemplar.

    Parameters
    ----------
    detail
        Synthesised detail component.
    exemplar
        Detail component it was made from; the size may differ.
    patch
        Side of the patches in pixels: repeats at smaller distances are the texture's own.

    Returns
    -------
    TextureFigures
        Mean detail angles in degrees, distances of slopes and spectra, repeat scores.

    Raises
    ------
    DataError
        If the patch is not at least 1 pixel.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap
    >>> from processing.synthesis import texture_figures
    >>> noise = np.random.default_rng(0).normal(scale=0.2, size=(128, 128, 3))
    >>> rough = NormalMap.from_vectors(noise + [0, 0, 1])
    >>> tiled = NormalMap(np.tile(rough.normals, (2, 2, 1)), np.tile(rough.mask, (2, 2)))
    >>> figures = texture_figures(tiled, rough, patch=32)
    >>> round(figures.repeat_score, 2), figures.exemplar_repeat_score < 0.2
    (1.0, True)
    """
    check_normal_map("detail", detail)
    check_normal_map("exemplar", exemplar)
    if patch < 1:
        raise DataError(f"a patch of {patch} pixels is too small: use at least 1")
    return TextureFigures(_middle(detail), _middle(exemplar), patch)


def _middle(part: NormalMap) -> NormalMap:
    if max(part.size) <= MOST:
        return part
    return NormalMap(part_in_middle(part.normals), part_in_middle(part.mask))


def _angles_deg(part: NormalMap) -> Float32:
    x, y, z = np.moveaxis(part.normals, 2, 0)
    angles: Float32 = np.degrees(np.arctan2(np.hypot(x, y), z))
    return angles[part.mask]


def _mean_angle_deg(part: NormalMap) -> float:
    return float(np.mean(_angles_deg(part), dtype=np.float64))


def _halves(part: NormalMap) -> tuple[NormalMap, NormalMap]:
    """Return the two halves of the bounding box of a mask, cut across its longer side."""
    rows, columns = bounding_box(part.mask)
    axis = 0 if rows.stop - rows.start >= columns.stop - columns.start else 1
    # Both halves have the same number of pixels with a normal.
    total = np.cumsum(part.mask.sum(axis=1 - axis))
    middle = max(int(np.searchsorted(total, total[-1] / 2)), 1)
    normals = np.split(part.normals, [middle], axis=axis)
    masks = np.split(part.mask, [middle], axis=axis)
    first, second = map(NormalMap, normals, masks)
    return first, second


def _spectrum_distance(a: NormalMap, b: NormalMap) -> float:
    block = block_side(a.mask, b.mask)
    if not block:
        return math.nan
    powers = [np.maximum(band_powers(part, block, BANDS).mean(axis=0), 1e-30) for part in (a, b)]
    return float(np.mean(np.abs(np.log(powers[0] / powers[1]))))


def _repeat_score(part: NormalMap, least: int) -> float:
    """Return the largest correlation of a detail with itself, shifted by at least a patch."""
    height, width = part.size
    inside = part.mask.astype(np.float32)
    slopes = [part.normals[..., k] * inside for k in range(2)]
    for values in slopes:
        values -= float(values.sum(dtype=np.float64) / inside.sum()) * inside
    rows, columns = (next_fast_len(2 * side, real=True) for side in (height, width))
    energy = np.square(slopes[0]) + np.square(slopes[1])
    total = float(energy.sum(dtype=np.float64))
    # One axis after the other, in place: the transforms of complete maps would take much memory.
    lags = [rfft(values, columns) for values in (inside, *slopes, energy)]
    del slopes, energy
    for first in range(0, lags[0].shape[1], _AT_ONCE):
        part_of = slice(first, first + _AT_ONCE)
        mask, x, y, power = (fft(one[:, part_of], rows, axis=0) for one in lags)
        # At each lag: pairs of pixels, the sum of their products, and the energies of both.
        products = (mask * mask.conj(), x * x.conj() + y * y.conj(), power * mask.conj())
        for values, product in zip(lags, (*products, power.conj() * mask), strict=True):
            values[:, part_of] = ifft(product, axis=0)[:height]
    across = np.minimum(np.arange(columns), columns - np.arange(columns))
    highest, least_energy = math.nan, _LEAST_ENERGY * total
    for first in range(0, height, _AT_ONCE):
        band = slice(first, first + _AT_ONCE)
        pairs, both, one, other = (irfft(values[band], columns) for values in lags)
        far = np.maximum(np.arange(height)[band, None], across) >= least
        # Numbers of pairs are whole; those of the transforms nearly.
        judged = far & (pairs > _LEAST_PAIRS * np.count_nonzero(part.mask) + 0.5)
        judged &= np.minimum(one, other) > least_energy
        if judged.any():
            energy = np.sqrt(one[judged] * other[judged])
            highest = float(np.fmax(highest, np.max(both[judged] / energy)))
    return highest
