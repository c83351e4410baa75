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

    The part that all lights share (reflections of the room) is subtracted. A highlight is the
    compact blob with the largest flux within 0.85 of the radius. A light is left out if its
    brightest blob is wide (a matte surface), is cut off by the frame, has a rival with half its
    flux, or has less than 3 % of the flux of the other lights (then the light is hidden, and the
    blob is its reflection from another sphere).

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
    radius = outline.radius_px
    x0, y0 = (np.floor(np.array(outline.centre_px) - radius * 1.1).astype(int)).clip(0)
    x1, y1 = np.ceil(np.array(outline.centre_px) + radius * 1.1).astype(int) + 1
    crop = values[:, y0:y1, x0:x1]
    pixels = np.full((len(values), 2), np.nan)
    saturated = np.isnan(crop)
    if crop.size == 0 or saturated.all():
        return Highlights(pixels, np.zeros(len(values), bool))
    filled = np.where(saturated, np.nanmax(crop), crop)
    if len(filled) >= 3:
        filled = filled - np.percentile(filled, 25, axis=0, method="lower").astype(np.float32)
    y, x = np.mgrid[y0 : y0 + crop.shape[1], x0 : x0 + crop.shape[2]]
    from_centre = np.linalg.norm(outline.unit(np.stack([x, y], axis=-1)), axis=-1)
    within = from_centre < _LARGEST_RADIUS
    height, width = values.shape[1:]
    border = (x == 0) | (y == 0) | (x == width - 1) | (y == height - 1)
    blobs = [_blob(image, within, radius) for image in filled]
    fluxes = np.array([np.nan if blob is None else blob[1] for blob in blobs])
    typical = float(np.median(fluxes[np.isfinite(fluxes)])) if np.isfinite(fluxes).any() else 0.0
    peak_saturated = np.zeros(len(values), bool)
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
    level = float(np.median(smooth[within])) if within.any() else 0.0
    noise = 1.4826 * float(np.median(np.abs(smooth[within] - level))) if within.any() else 0.0
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
    noise in its wings has little weight.
    """
    y, x = np.nonzero(region)
    weight = np.clip(image[y, x].astype(np.float64), 1e-12, None)
    centre = np.array([np.average(x, weights=weight), np.average(y, weights=weight)])
    sigma = max(np.sqrt(np.count_nonzero(region) / np.pi), 1.0)
    half = int(np.ceil(4 * sigma)) + 1
    rows, columns = np.mgrid[
        max(int(y.mean()) - half, 0) : min(int(y.mean()) + half + 1, image.shape[0]),
        max(int(x.mean()) - half, 0) : min(int(x.mean()) + half + 1, image.shape[1]),
    ]
    window = image[rows, columns].astype(np.float64)
    far = np.hypot(columns - centre[0], rows - centre[1]) > 3 * sigma
    window -= np.median(window[far]) if far.any() else 0.0
    for _ in range(60):
        gauss = np.exp(-((columns - centre[0]) ** 2 + (rows - centre[1]) ** 2) / (2 * sigma**2))
        total = np.sum(gauss * window)
        if not total > 0:
            break
        offset = np.array([np.sum(gauss * window * columns), np.sum(gauss * window * rows)])
        # Double the shift: the window moves the weighted mean half-way back to its own centre.
        shift = 2 * (offset / total - centre)
        centre = centre + shift
        if np.hypot(*shift) < 1e-5:
            break
    return centre
