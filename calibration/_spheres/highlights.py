"""Sub-pixel positions of the highlight of each light on a sphere."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from calibration._radiance.raw_stack import Images
from calibration._spheres.ellipse import Ellipse
from calibration._spheres.robust import Array
from calibration._spheres.spot import largest_disc, saturated_spot, unsaturated_spot

# A light 115 degrees away from the camera's axis appears at sin(115 / 2) = 0.84 of the radius.
# Bright spots farther out are not lights but another sphere or the table.
_LARGEST_RADIUS = 0.85
_BLOB_LEVEL = 0.3
_CORE_LEVEL = 0.85
_SMOOTH_PX = 0.7
_LARGEST_BLOB = 0.35
_FAINTEST_FLUX = 0.03
_RIVAL_FLUX = 0.5
# Pixels from which the median brightness of a large sphere is taken.
_SAMPLED = 40000
_BAND_ROWS = 16


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
    """

    pixels: Array
    saturated: npt.NDArray[np.bool_]
    sigma_px: Array

    @property
    def found(self) -> npt.NDArray[np.bool_]:
        """``(N,)`` whether the highlight of each light was found."""
        return np.isfinite(self.pixels[:, 0])


def find_highlights(values: Images, outline: Ellipse) -> Highlights:
    """Find the highlight of every light on a sphere.

    From three lights on, the brightness that more than three quarters of them share (reflections of
    the room) is subtracted. A highlight is the compact blob with the largest flux within 0.85 of
    the radius; if it is saturated, its core without rays. A light is left out if its brightest blob
    is wider than 0.35 of the radius (a matte surface), is cut off by the frame, has a rival with
    more than half its flux, or has less than 3 % of the median flux of all lights (then the light
    is hidden, and the blob is its reflection from another sphere).

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, NaN where saturated.
    outline
        The sphere's outline.

    Returns
    -------
    Highlights
        Unsaturated peaks are located by an iterated Gaussian-weighted centroid, saturated peaks by
        the contours of their cores, which ignore rays and glare.
    """
    # The windows of spots at the rim extend a little beyond 0.85 of the radius.
    reach = (_LARGEST_RADIUS + 0.05) * max(outline.semi_axes_px) + 4
    x0, y0 = (np.array(outline.centre_px) - reach).astype(int).clip(0)
    x1, y1 = (np.array(outline.centre_px) + reach).astype(int) + 2
    crop = values[:, y0:y1, x0:x1]
    pixels = np.full((len(values), 2), np.nan)
    sigma_px = np.full(len(values), np.nan)
    peak_saturated = np.zeros(len(values), bool)
    rows, columns = np.indices(crop.shape[1:])
    places = np.stack([columns + x0, rows + y0], axis=-1)
    within = np.linalg.norm(outline.unit(places), axis=-1) < _LARGEST_RADIUS
    saturated = np.isnan(crop)
    if saturated.all() or not within.any():
        return Highlights(pixels, peak_saturated, sigma_px)
    # Parts of raw frames are new arrays.
    filled = crop.copy() if isinstance(values, np.ndarray) else crop
    filled[saturated] = np.fmax.reduce(crop, axis=None)
    if len(filled) >= 3:
        _subtract_shared(filled)
    last = np.array(values.shape[:0:-1]) - 1
    border = np.any((places == 0) | (places == last), axis=-1)
    sample = np.flatnonzero(within)
    sample = sample[:: max(len(sample) // _SAMPLED, 1)]
    blobs = [
        _blob(image, clipped & within, within, sample, outline.radius_px)
        for image, clipped in zip(filled, saturated, strict=True)
    ]
    typical = np.median([blob.flux for blob in blobs if blob is not None] or [0.0])
    for i, blob in enumerate(blobs):
        if blob is None or blob.flux < _FAINTEST_FLUX * typical or np.any(blob.region & border):
            continue
        image = filled[i] - np.float32(blob.level)
        clipped = saturated[i] & blob.region
        if clipped.any():
            spot = saturated_spot(image, blob.region, float(image[clipped].min()))
        else:
            spot = unsaturated_spot(image, blob.region, blob.noise)
        place = spot.centre + np.array([x0, y0])
        if np.linalg.norm(outline.unit(place)) < _LARGEST_RADIUS:
            pixels[i], sigma_px[i], peak_saturated[i] = place, spot.sigma_px, clipped.any()
    return Highlights(pixels, peak_saturated, sigma_px)


def _subtract_shared(stack: npt.NDArray[np.float32]) -> None:
    """Subtract the lower quartile over the images ``(N, H, W)`` at each pixel, in place."""
    quartile = (len(stack) - 1) // 4
    for top in range(0, stack.shape[1], _BAND_ROWS):
        band = stack[:, top : top + _BAND_ROWS]
        band -= np.partition(band, quartile, axis=0)[quartile]


@dataclass(frozen=True, eq=False)
class _Blob:
    """Pixels and flux of a highlight, and level and noise of the image around it."""

    region: npt.NDArray[np.bool_]
    flux: float
    level: float
    noise: float


def _blob(
    image: npt.NDArray[np.float32],
    saturated: npt.NDArray[np.bool_],
    within: npt.NDArray[np.bool_],
    sample: npt.NDArray[np.intp],
    radius_px: float,
) -> _Blob | None:
    """Return the only compact bright blob, or None; ``sample`` has some indices of ``within``."""
    smooth = np.where(within, cv2.GaussianBlur(image, (0, 0), _SMOOTH_PX), np.float32(0))
    peak = float(smooth.max())
    typical = smooth.ravel()[sample]
    level = float(np.median(typical))
    noise = 1.4826 * float(np.median(np.abs(typical - level)))
    # Saturated pixels are not noise, and their glare may cover half of the sphere.
    if not peak - level > max((2 if saturated.any() else 12) * noise, 1e-6):
        return None
    for share in (_BLOB_LEVEL, _CORE_LEVEL):
        bright = (smooth > level + share * (peak - level)).astype(np.uint8)
        count, regions = cv2.connectedComponents(bright)
        where = np.flatnonzero(bright)
        flux = np.bincount(regions.ravel()[where], image.ravel()[where] - level, count)
        first = int(np.argmax(flux))
        region = regions == first
        # Around a saturated core, rays and glare are not part of it.
        if not np.any(saturated & region):
            break
    if _width_px(region, core=bool(np.any(saturated & region))) > max(_LARGEST_BLOB * radius_px, 3):
        return None
    flux_of_first = float(flux[first])
    flux[first] = 0.0
    if float(flux.max()) > _RIVAL_FLUX * flux_of_first:
        return None
    # Smoothing divides the noise of a pixel by the root of the area of its kernel, 4 pi sigma^2.
    return _Blob(region, flux_of_first, level, noise * float(np.sqrt(4 * np.pi)) * _SMOOTH_PX)


def _width_px(region: npt.NDArray[np.bool_], *, core: bool) -> float:
    """Return the width of the largest disc in a core, or of the disc with the area of a region."""
    if core:
        return 2 * largest_disc(region)[1]
    return 2 * float(np.sqrt(np.count_nonzero(region) / np.pi))
