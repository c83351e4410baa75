"""Sub-pixel positions of the highlight of each light on a sphere."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from calibration._spheres.ellipse import Ellipse
from calibration._spheres.robust import Array

# A light 115 degrees away from the camera's axis appears at sin(115 / 2) = 0.84 of the radius.
# Bright spots farther out are not lights but another sphere or the table.
_LARGEST_RADIUS = 0.85
_BLOB_LEVEL = 0.3
_LARGEST_BLOB = 0.35
_FAINTEST_FLUX = 0.03
_RIVAL_FLUX = 0.5


@dataclass(frozen=True, eq=False)
class Highlights:
    """The highlights of N lights on one sphere.

    Parameters
    ----------
    pixels
        ``(N, 2)`` positions (x, y); NaN if there is no highlight.
    saturated
        ``(N,)`` whether the peak is saturated; the position is then the centre of a blob.
    """

    pixels: Array
    saturated: npt.NDArray[np.bool_]

    @property
    def found(self) -> npt.NDArray[np.bool_]:
        """``(N,)`` whether the highlight of each light was found."""
        return np.isfinite(self.pixels[:, 0])


def find_highlights(values: npt.NDArray[np.float32], outline: Ellipse) -> Highlights:
    """Find the highlight of every light on a sphere.

    From three lights on, the brightness that more than three quarters of them share (reflections of
    the room) is subtracted. A highlight is the compact blob with the largest flux within 0.85 of
    the radius. A light is left out if its brightest blob is wider than 0.35 of the radius (a matte
    surface), is cut off by the frame, has a rival with more than half its flux, or has less than
    3 % of the median flux of all lights (then the light is hidden, and the blob is its reflection
    from another sphere).

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
        the centroid of the pixels above half of the white level.
    """
    # Contains 0.85 of the long axis even if the axes have a ratio of 1.5.
    reach = 1.1 * outline.radius_px
    x0, y0 = (np.array(outline.centre_px) - reach).astype(int).clip(0)
    x1, y1 = (np.array(outline.centre_px) + reach).astype(int) + 2
    crop = values[:, y0:y1, x0:x1]
    pixels = np.full((len(values), 2), np.nan)
    peak_saturated = np.zeros(len(values), bool)
    rows, columns = np.indices(crop.shape[1:])
    places = np.stack([columns + x0, rows + y0], axis=-1)
    within = np.linalg.norm(outline.unit(places), axis=-1) < _LARGEST_RADIUS
    saturated = np.isnan(crop)
    if saturated.all() or not within.any():
        return Highlights(pixels, peak_saturated)
    filled = np.where(saturated, np.nanmax(crop), crop)
    if len(filled) >= 3:
        filled = filled - np.percentile(filled, 25, axis=0, method="lower").astype(np.float32)
    last = np.array(values.shape[:0:-1]) - 1
    border = np.any((places == 0) | (places == last), axis=-1)
    blobs = [_blob(image, within, outline.radius_px) for image in filled]
    typical = np.median([blob[1] for blob in blobs if blob is not None] or [0.0])
    for i, blob in enumerate(blobs):
        if blob is None or blob[1] < _FAINTEST_FLUX * typical:
            continue
        region = blob[0]
        if np.any(region & border):
            continue
        peak_saturated[i] = bool(np.any(saturated[i] & region))
        if peak_saturated[i]:
            centre = _clipped_centroid(filled[i], region)
        else:
            centre = _weighted_centroid(filled[i], region)
        place = centre + np.array([x0, y0])
        if np.linalg.norm(outline.unit(place)) < _LARGEST_RADIUS:
            pixels[i] = place
    return Highlights(pixels, peak_saturated & np.isfinite(pixels[:, 0]))


def _blob(
    image: npt.NDArray[np.float32], within: npt.NDArray[np.bool_], radius_px: float
) -> tuple[npt.NDArray[np.bool_], float] | None:
    """Return the region and flux of the only compact bright blob, or None."""
    smooth = np.where(within, cv2.GaussianBlur(image, (0, 0), 0.7), 0.0)
    peak = float(smooth.max())
    level = float(np.median(smooth[within]))
    noise = 1.4826 * float(np.median(np.abs(smooth[within] - level)))
    if not peak - level > max(12 * noise, 1e-6):
        return None
    bright = (smooth > level + _BLOB_LEVEL * (peak - level)).astype(np.uint8)
    count, regions = cv2.connectedComponents(bright)
    flux = np.bincount(regions.ravel(), (image - level).ravel(), count)
    flux[0] = 0.0
    first = int(np.argmax(flux))
    region = regions == first
    if 2 * np.sqrt(np.count_nonzero(region) / np.pi) > max(_LARGEST_BLOB * radius_px, 3.0):
        return None
    flux_of_first = float(flux[first])
    flux[first] = 0.0
    if float(flux.max()) > _RIVAL_FLUX * flux_of_first:
        return None
    return region, flux_of_first


def _clipped_centroid(
    image: npt.NDArray[np.float32], region: npt.NDArray[np.bool_]
) -> npt.NDArray[np.float64]:
    """Return the centroid of a saturated blob, weighted by the excess over half its maximum."""
    y, x = np.nonzero(region)
    values = image[y, x].astype(np.float64)
    weight = np.clip(values - 0.5 * values.max(), 1e-12, None)
    return np.array([np.average(x, weights=weight), np.average(y, weights=weight)])


def _weighted_centroid(
    image: npt.NDArray[np.float32], region: npt.NDArray[np.bool_]
) -> npt.NDArray[np.float64]:
    """Return the iterated Gaussian-weighted centroid (SExtractor's XWIN) without background.

    The window follows the spot, so the positions of the pixels do not bias a symmetric spot, and
    noise in its wings and its neighbours have little weight.
    """
    y, x = np.nonzero(region)
    weight = np.clip(image[y, x].astype(np.float64), 1e-12, None)
    centre = np.array([np.average(x, weights=weight), np.average(y, weights=weight)])
    sigma = np.sqrt(np.count_nonzero(region) / np.pi)
    half = int(5 * sigma)
    top, left = max(int(y.mean()) - half, 0), max(int(x.mean()) - half, 0)
    window = image[top : int(y.mean()) + half + 1, left : int(x.mean()) + half + 1]
    rows, columns = np.indices(window.shape) + np.array([top, left])[:, None, None]
    # More than half of the window is background.
    excess = window.astype(np.float64) - np.median(window)
    for _ in range(60):
        gauss = np.exp(-((columns - centre[0]) ** 2 + (rows - centre[1]) ** 2) / (2 * sigma**2))
        total = np.sum(gauss * excess)
        if not total > 0:
            break
        offset = np.array([np.sum(gauss * excess * columns), np.sum(gauss * excess * rows)])
        # Double the shift: the window moves the weighted mean half-way back to its own centre.
        shift = 2 * (offset / total - centre)
        centre = centre + shift
        if np.hypot(*shift) < 1e-5:
            break
    return centre
