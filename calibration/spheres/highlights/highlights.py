"""Sub-pixel positions of the highlight of each light on a sphere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibration.radiance.stack import Images
from calibration.spheres.geometry.ellipse import Ellipse
from calibration.spheres.highlights.blobs import MOST_BLOBS, Blob, bright_blobs, usual_size
from calibration.spheres.highlights.spot import Spot
from rig import short_repr
from rig.arrays import Bool, Float32, Float64, Intp

# A light 115 degrees away from the camera's axis appears at sin(115 / 2) = 0.84 of the radius.
# Bright spots farther out are not lights but another sphere or the table.
_LARGEST_RADIUS = 0.85
_FAINTEST = 0.03
_RIVAL_FLUX = 0.5
# A spot at one place under several lights is a lamp, unless most lights share their places.
_SAME_PX, _SAME_SHARE = 0.5, 0.01
# Two parts of a highlight that a bright reflection cuts in two have the same centre.
_ONE_SPOT_PX = 1.0
_LEAST_SHARED, _MORE_SHARED = 3, 2
_LAMPS, _AS_BRIGHT = 3, 0.6
# One percent of the radius is an error of a degree.
_UNLIKE = 0.01
# Of a smooth peak, a tenth of the pixels above 0.8 of it are above 0.98, fewer if it is noisy. Of a
# saturated one that JPEG was applied to, a third, of which a fifth and 12 or more are equal.
_EVEN, _NEARLY, _EVEN_SHARE = 0.98, 0.8, 1 / 3
_EQUAL, _EQUAL_SHARE, _EQUAL_PX = 1 - 1e-4, 0.2, 12
# Saturated pixels from which this little of white is subtracted are still even.
_UNCUT = 0.95
# Pixels from which the median brightness of a large sphere is taken.
_SAMPLED = 40000
_BAND_ROWS = 16


@dataclass(frozen=True, eq=False)
class Candidates:
    """Places that may be the highlights of N lights on one sphere, at most M for each light.

    Parameters
    ----------
    pixels
        ``(N, M, 2)`` positions (x, y), those with the largest flux first; NaN if there are fewer.
    saturated
        ``(N, M)`` whether the peak is saturated.
    sigma_px
        ``(N, M)`` standard deviation of each coordinate.
    share
        ``(N, M)`` flux relative to the first one.
    photon_px2
        ``(N, M)`` as `Highlights.photon_px2`, None if it is not known.
    """

    pixels: Float64
    saturated: Bool
    sigma_px: Float64
    share: Float64
    photon_px2: Float64 | None = None

    __repr__ = short_repr

    @property
    def seen(self) -> Bool:
        """``(N,)`` whether there is any."""
        return np.asarray(np.any(np.isfinite(self.pixels[..., 0]), axis=1), np.bool_)


@dataclass(frozen=True, eq=False)
class Highlights:
    """The highlights of N lights on one sphere.

    Parameters
    ----------
    pixels
        ``(N, 2)`` positions (x, y); NaN if there is no highlight.
    saturated
        ``(N,)`` whether the peak is saturated; the position is then the centre of its core.
    sigma_px
        ``(N,)`` standard deviation of each coordinate of a position; NaN if there is no highlight.
    several
        All places that may be the highlight, that of ``pixels`` among them; None if there are no
        others.
    unlike
        Indices of the lights whose saturated highlights are larger or smaller than the others, so
        that they may be off by more than a degree.
    photon_px2
        ``(N,)`` variance of each coordinate by photon noise, if one photon had the brightness 1;
        NaN where it is not known. None if it is not known of any.
    """

    pixels: Float64
    saturated: Bool
    sigma_px: Float64
    several: Candidates | None = None
    unlike: tuple[int, ...] = ()
    photon_px2: Float64 | None = None

    __repr__ = short_repr

    @property
    def candidates(self) -> Candidates:
        """All places that may be the highlight."""
        if self.several is not None:
            return self.several
        single = _no_candidates(len(self.pixels))
        single.pixels[:, 0], single.sigma_px[:, 0] = self.pixels, self.sigma_px
        single.saturated[:, 0], single.share[:, 0] = self.saturated, 1.0
        return single

    @property
    def found(self) -> Bool:
        """``(N,)`` whether the highlight of each light was found."""
        return np.isfinite(self.pixels[:, 0])

    @property
    def ambiguous(self) -> Bool:
        """``(N,)`` whether several places may be the highlight, and none was chosen."""
        several = np.isfinite(self.candidates.pixels[..., 0]).sum(axis=1) > 1
        return np.asarray(several & ~self.found, np.bool_)

    def chosen(self, picks: Intp) -> Highlights:
        """Return these highlights with the candidate ``picks (N,)`` of each light; -1 for none."""
        rows, none = np.arange(len(picks)), picks < 0
        of = self.candidates
        return replace(
            self,
            pixels=np.where(none[:, None], np.nan, of.pixels[rows, picks]),
            saturated=of.saturated[rows, picks] & ~none,
            sigma_px=np.where(none, np.nan, of.sigma_px[rows, picks]),
            photon_px2=None if of.photon_px2 is None else of.photon_px2[rows, picks],
        )

    def take(self, rows: Sequence[int]) -> Highlights:
        """Return the highlights of some lights; a light ``-1`` has none."""
        index = np.asarray(rows, np.intp)
        none = index < 0
        of = self.candidates

        def taken(values: Float64) -> Float64:
            return np.where(none.reshape(-1, *[1] * (values.ndim - 1)), np.nan, values[index])

        several = Candidates(
            taken(of.pixels),
            of.saturated[index] & ~none[:, None],
            taken(of.sigma_px),
            taken(of.share),
            None if of.photon_px2 is None else taken(of.photon_px2),
        )
        return Highlights(
            taken(self.pixels),
            self.saturated[index] & ~none,
            taken(self.sigma_px),
            several,
            tuple(k for k, light in enumerate(rows) if light in self.unlike),
            None if self.photon_px2 is None else taken(self.photon_px2),
        )

    def moved(self, by_px: Float64, sigma_px: float) -> Highlights:
        """Return these highlights elsewhere.

        Parameters
        ----------
        by_px
            ``(N, 2)`` right and down.
        sigma_px
            Standard deviation of each of its coordinates.
        """
        of = self.candidates
        several = replace(
            of, pixels=of.pixels + by_px[:, None], sigma_px=np.hypot(of.sigma_px, sigma_px)
        )
        return replace(
            self,
            pixels=self.pixels + by_px,
            sigma_px=np.hypot(self.sigma_px, sigma_px),
            several=several,
        )


def _no_candidates(count: int) -> Candidates:
    size = count, MOST_BLOBS
    nan, no = np.full(size, np.nan), np.zeros(size, bool)
    return Candidates(np.full((*size, 2), np.nan), no, nan, nan.copy())


def _none(count: int) -> Highlights:
    """Return highlights of lights that are not seen."""
    nan, no = np.full(count, np.nan), np.zeros(count, bool)
    return Highlights(np.full((count, 2), np.nan), no, nan, _no_candidates(count))


def find_highlights(values: Images, outline: Ellipse) -> Highlights:
    """Find the highlight of every light on a sphere.

    From three lights on, the brightness that more than three quarters of them share (reflections of
    the room) is subtracted, and so is a lamp: a spot at the same place under three or more lights,
    if other lights do not share theirs. A highlight is the compact blob with the largest flux
    within 0.85 of the radius; if it is saturated, its core without rays. A light is left out if
    its brightest blob is wider than 0.35 of the radius (a matte surface), is cut off by the frame,
    has a rival with more than half its flux, or has less than 3 % of the median flux or height of
    all lights (then the light is hidden, and the blob is its reflection from another sphere).
    Rivals with more than a tenth of its flux are kept as candidates.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, NaN where saturated; even tops of highlights count as well.
    outline
        The sphere's outline.

    Returns
    -------
    Highlights
        Unsaturated peaks are located by an iterated Gaussian-weighted centroid, saturated peaks by
        the contours of their cores, which ignore rays and glare.

    Examples
    --------
    >>> import numpy as np
    >>> from calibration.spheres import Ellipse, find_highlights
    >>> y, x = np.indices((80, 80))
    >>> spot = np.exp(-((x - 45) ** 2 + (y - 35) ** 2) / 8)
    >>> find_highlights(spot[None].astype(np.float32), Ellipse((40, 40), (30, 30))).pixels.round(1)
    array([[45., 35.]])
    """
    # The windows of spots at the rim extend a little beyond 0.85 of the radius.
    reach = (_LARGEST_RADIUS + 0.05) * max(outline.semi_axes_px) + 4
    x0, y0 = (np.array(outline.centre_px) - reach).astype(int).clip(0)
    x1, y1 = (np.array(outline.centre_px) + reach).astype(int) + 2
    filled = np.array(values[:, y0:y1, x0:x1])
    rows, columns = (
        np.arange(first, first + size)
        for first, size in zip((y0, x0), filled.shape[1:], strict=True)
    )
    within = _within(outline, rows, columns)
    saturated = np.isnan(filled)
    if saturated.all() or not within.any():
        return _none(len(values))
    peaks = np.fmax.reduce(filled, axis=(1, 2))
    top = np.fmax.reduce(peaks)
    # Images of a longer exposure are saturated at a lower radiance than others reach.
    white = np.asarray(np.where(peaks < top / 2, peaks, top), np.float32)
    filled[saturated] = np.broadcast_to(white[:, None, None], filled.shape)[saturated]
    for k in np.flatnonzero(~np.any(saturated & within, axis=(1, 2))):
        even = _even_top(filled[k], within)
        if even is not None:
            saturated[k], white[k] = even, filled[k][even].min()
    if len(filled) >= 3:
        _subtract_shared(filled)
        saturated &= 4 * saturated.sum(axis=0) <= 3 * len(filled)
    border = np.zeros(within.shape, bool)
    border[(rows == 0) | (rows == values.shape[1] - 1)] = True
    border[:, (columns == 0) | (columns == values.shape[2] - 1)] = True
    search = _Search(filled, saturated, within, border, outline, (int(x0), int(y0)), white)
    blobs = [search.blobs(k) for k in range(len(filled))]
    found = search.located(blobs)
    for _ in range(_LAMPS):
        lamp = _lamp(found.candidates.pixels, outline.radius_px)
        if lamp is None:
            break
        lit = search.lit(*lamp)
        search.subtract(lit)
        for k in lit:
            blobs[k] = search.blobs(k)
        found = search.located(blobs)
    return found


def _within(outline: Ellipse, rows: Intp, columns: Intp) -> Bool:
    """Return which pixels of some rows and columns are within 0.85 of the radius."""
    across, down = columns - outline.centre_px[0], (rows - outline.centre_px[1])[:, None]
    (xx, xy), (yx, yy) = np.linalg.inv(outline.matrix)
    within: Bool = np.hypot(xx * across + yx * down, xy * across + yy * down) < _LARGEST_RADIUS
    return within


@dataclass(frozen=True, eq=False)
class _Search:
    """Images ``(N, h, w)`` around a sphere, and the pixels on which highlights are searched for.

    What the images share is subtracted from them. Pixels that are saturated in most images count as
    not saturated, because nothing is left of them. Before, the others were ``white (N,)``.
    """

    images: Float32
    saturated: Bool
    within: Bool
    border: Bool
    outline: Ellipse
    corner: tuple[int, int]
    white: Float32

    def blobs(self, k: int) -> list[Blob]:
        image, clipped = self.images[k], self.saturated[k] & self.within
        return bright_blobs(image, clipped, self.within, self._sample, self.outline.radius_px)

    @cached_property
    def _sample(self) -> Intp:
        """Some pixels on which highlights are searched for."""
        sample = np.flatnonzero(self.within)
        return sample[:: max(len(sample) // _SAMPLED, 1)]

    def lit(self, lights: Intp, place: Float64) -> Intp:
        """Return the lights under which a place is as bright as under some of them.

        A highlight next to a lamp may hide the spot of the lamp, but not its brightness.
        """
        column, row = np.rint(place - self.corner).astype(int)
        brightness = self.images[:, row, column]
        return np.flatnonzero(brightness > _AS_BRIGHT * np.median(brightness[lights]))

    def subtract(self, lit: Intp) -> None:
        """Subtract what the images under some lights share."""
        some = self.images[lit]
        _subtract_shared(some)
        self.images[lit] = some
        self.saturated[lit] &= 4 * self.saturated[lit].sum(axis=0) <= 3 * len(lit)

    def located(self, blobs: list[list[Blob]]) -> Highlights:
        """Return the positions of blobs, and which of them are highlights."""
        result = _none(len(blobs))
        brightest = [(of_one[0].flux, of_one[0].height) for of_one in blobs if of_one]
        least = _FAINTEST * np.median(brightest or [(0.0, 0.0)], axis=0)
        of = result.candidates
        radii_px, photon_px2, stray_px = np.full((3, *of.share.shape), np.nan)
        for k, of_one in enumerate(blobs):
            rank = 0
            for blob in of_one:
                faint = blob.flux < least[0] or blob.height < least[1]
                if faint or np.any(blob.region & self.border):
                    continue
                spot = self.spot(k, blob)
                place = spot.centre + np.array(self.corner)
                if not np.linalg.norm(self.outline.unit(place)) < _LARGEST_RADIUS:
                    continue
                share = blob.flux / of_one[0].flux
                off = np.linalg.norm(of.pixels[k, :rank] - place, axis=1)
                if np.any(off < _ONE_SPOT_PX):
                    of.share[k, int(np.argmin(off))] += share
                    continue
                of.pixels[k, rank], of.sigma_px[k, rank] = place, spot.sigma_px
                of.saturated[k, rank], of.share[k, rank] = blob.saturated, share
                radii_px[k, rank], photon_px2[k, rank] = spot.radius_px, spot.photon_px2
                stray_px[k, rank] = spot.stray_px
                rank += 1
            largest = of.share[k, 0]
            if largest >= 1 and of_one[0].rival <= _RIVAL_FLUX * largest * of_one[0].flux:
                result.pixels[k], result.sigma_px[k] = of.pixels[k, 0], of.sigma_px[k, 0]
                result.saturated[k] = of.saturated[k, 0]
        result = replace(
            result, photon_px2=photon_px2[:, 0], several=replace(of, photon_px2=photon_px2)
        )
        return self._by_size(result, radii_px, stray_px)

    def _by_size(self, found: Highlights, radii_px: Float64, stray_px: Float64) -> Highlights:
        """Choose the spots that have the usual size of a highlight, and widen errors of others.

        If the size is known, the only spot of this size is the highlight, and without one,
        the brightest spot is its only trace.
        """
        of = found.candidates
        size = usual_size(radii_px, of.sigma_px)
        if size is None:
            of.sigma_px[:] = np.hypot(of.sigma_px, stray_px)
            return replace(found, sigma_px=np.hypot(found.sigma_px, stray_px[:, 0]))
        picks = np.where(found.found, 0, -1)
        if size.known:
            usual = size.matches(radii_px)
            count = usual.sum(axis=1)
            picks = np.where(count == 1, np.argmax(usual, axis=1), picks)
            picks = np.where((count == 0) & of.seen, 0, picks)
        chosen, rows = found.chosen(picks), np.arange(len(picks))
        part, radius_px = size.part_px(radii_px), self.outline.radius_px
        elsewhere = size.elsewhere_px(radii_px[rows, picks], chosen.sigma_px, radius_px)
        off = np.hypot(part[rows, picks], elsewhere)
        of.sigma_px[:, 0] = np.hypot(of.sigma_px[:, 0], part[:, 0])
        unlike = np.flatnonzero(chosen.found & (off > _UNLIKE * radius_px))
        # Stray light does not decide which spot is the highlight, but adds to all errors.
        of.sigma_px[:] = np.hypot(of.sigma_px, stray_px)
        sigma_px = np.hypot(np.hypot(chosen.sigma_px, off), stray_px[rows, picks])
        return replace(chosen, sigma_px=sigma_px, unlike=tuple(unlike.tolist()))

    def spot(self, k: int, blob: Blob) -> Spot:
        """Return the centre of a blob.

        How much brighter than white saturated pixels are is not known. If what the images share is
        subtracted from them, it may cut through a highlight; otherwise, a reflection that is
        saturated, too, may seem a part of it. The rounder one of the two is the highlight. If the
        other one is nearly as round, their difference is in the error.
        """
        image, clipped = self.images[k], self.saturated[k]
        spot = blob.locate(image, clipped)
        white = self.white[k]
        if not blob.saturated or _uncut(image, clipped, blob.region, white):
            return spot
        whole = blob.locate(np.where(clipped, white, image), clipped)
        best, other = sorted((spot, whole), key=lambda one: one.sigma_px)
        weight = best.sigma_px / (best.sigma_px + other.sigma_px)
        doubt = weight * float(np.sum((best.centre - other.centre) ** 2)) / 2
        return replace(best, sigma_px=float(np.sqrt(best.sigma_px**2 + doubt)))


def _even_top(image: Float32, within: Bool) -> Bool | None:
    """Return the pixels of a sphere that are saturated below white, or None.

    Images that were made darker, divided by the strength of a light, or converted with headroom
    have no sample at white, but the tops of their highlights are even.
    """
    largest = float(np.max(image, where=within, initial=0.0))
    bright = image[within & (image > _NEARLY * largest)]
    even, equal = (np.count_nonzero(bright >= at * largest) for at in (_EVEN, _EQUAL))
    if even < _EVEN_SHARE * len(bright) or equal < max(_EQUAL_SHARE * even, _EQUAL_PX):
        return None
    return within & (image >= _EVEN * largest)


def _uncut(image: Float32, clipped: Bool, region: Bool, white: float) -> bool:
    """Return whether hardly anything was subtracted from saturated pixels around a region."""
    rows, columns = (np.flatnonzero(region.any(axis=axis)) for axis in (1, 0))
    wide = max(len(rows), len(columns))
    box = tuple(slice(max(of[0] - wide, 0), of[-1] + wide + 1) for of in (rows, columns))
    return bool(np.all(image[box][clipped[box]] > _UNCUT * white))


def _lamp(pixels: Float64, radius_px: float) -> tuple[Intp, Float64] | None:
    """Return lights under which a sphere shows a spot at the same place, and the place, or None.

    Lights that were recorded several times share their places, too, but all of them do.
    """
    light, rank = np.nonzero(np.isfinite(pixels[..., 0]))
    spots = pixels[light, rank]
    if not len(spots):
        return None
    near = np.linalg.norm(spots[:, None] - spots, axis=-1) < min(_SAME_PX, _SAME_SHARE * radius_px)
    count = near.sum(axis=1)
    usual = float(np.percentile(count, 25, method="lower"))
    most = int(np.argmax(count))
    if count[most] < _LEAST_SHARED or count[most] <= _MORE_SHARED * usual:
        return None
    return np.unique(light[near[most]]), np.median(spots[near[most]], axis=0)


def _subtract_shared(stack: Float32) -> None:
    """Subtract the lower quartile over the images ``(N, H, W)`` at each pixel, in place."""
    quartile = (len(stack) - 1) // 4
    for top in range(0, stack.shape[1], _BAND_ROWS):
        band = stack[:, top : top + _BAND_ROWS]
        band -= np.partition(band, quartile, axis=0)[quartile]
