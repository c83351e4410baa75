"""Compact bright blobs on a sphere in one image: the highlight of a light, and its rivals."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from calibration._spheres.spot import Spot, largest_disc, saturated_spot, unsaturated_spot

Region = npt.NDArray[np.bool_]
Image = npt.NDArray[np.float32]

_BLOB_LEVEL = 0.3
_CORE_LEVEL = 0.85
_SMOOTH_PX = 0.7
_LARGEST_BLOB = 0.35
# A blob with a smaller share of the flux of the brightest one is a reflection or a part of a ray.
_RIVAL_FLUX = 0.1
MOST_BLOBS = 3


@dataclass(frozen=True, eq=False)
class Blob:
    """Pixels, flux and height of a bright blob, and level and noise of the image around it.

    ``rival`` is the largest flux of another blob, compact or not.
    """

    region: Region
    flux: float
    height: float
    level: float
    noise: float
    saturated: bool
    rival: float

    def locate(self, image: Image, clipped: Region) -> Spot:
        """Return its centre in the image in which it was found."""
        above = image - np.float32(self.level)
        if self.saturated:
            white = float(above[clipped & self.region].min())
            return saturated_spot(above, self.region, white)
        return unsaturated_spot(above, self.region, self.noise)


def bright_blobs(
    image: Image,
    saturated: Region,
    within: Region,
    sample: npt.NDArray[np.intp],
    radius_px: float,
) -> list[Blob]:
    """Return the compact bright blobs of an image, the one with the largest flux first.

    Parameters
    ----------
    image
        ``(H, W)`` around the sphere, at least white where saturated.
    saturated
        ``(H, W)`` saturated pixels on the sphere.
    within
        ``(H, W)`` pixels on which highlights are searched for.
    sample
        Some indices of ``within``, for the level of the image and its noise.
    radius_px
        Radius of the sphere.

    Returns
    -------
    list of Blob
        At most 3; empty if nothing exceeds the noise, or if the brightest blob is not compact. The
        others are compact and have more than a tenth of its flux.
    """
    smooth = np.where(within, cv2.GaussianBlur(image, (0, 0), _SMOOTH_PX), np.float32(0))
    peak = float(smooth.max())
    typical = smooth.ravel()[sample]
    level = float(np.median(typical))
    noise = 1.4826 * float(np.median(np.abs(typical - level)))
    clipped = np.flatnonzero(saturated)
    # Saturated pixels are not noise, and their glare may cover half of the sphere.
    if not peak - level > max((2 if len(clipped) else 12) * noise, 1e-6):
        return []
    for share in (_BLOB_LEVEL, _CORE_LEVEL):
        bright = (smooth > level + share * (peak - level)).astype(np.uint8)
        count, regions = cv2.connectedComponents(bright)
        where = np.flatnonzero(bright)
        flux = np.bincount(regions.ravel()[where], image.ravel()[where] - level, count)
        # Around a saturated core, rays and glare are not part of it.
        if int(np.argmax(flux)) not in regions.ravel()[clipped]:
            break
    # Smoothing divides the noise of a pixel by the root of the area of its kernel, 4 pi sigma^2.
    noise *= float(np.sqrt(4 * np.pi)) * _SMOOTH_PX
    blobs: list[Blob] = []
    order = np.argsort(-flux)[:MOST_BLOBS]
    for index in order:
        if not flux[index] > (_RIVAL_FLUX * blobs[0].flux if blobs else 0):
            break
        region = regions == index
        core = bool(region.ravel()[clipped].any())
        if _width_px(region, core=core) <= max(_LARGEST_BLOB * radius_px, 3):
            rival = float(flux[order[0 if blobs else 1]])
            height = float(smooth[region].max()) - level
            blobs.append(Blob(region, float(flux[index]), height, level, noise, core, rival))
        elif not blobs:
            break
    return blobs


def _width_px(region: Region, *, core: bool) -> float:
    """Return the width of the largest disc in a core, or of the disc with the area of a region."""
    if core:
        return 2 * largest_disc(region)[1]
    return 2 * float(np.sqrt(np.count_nonzero(region) / np.pi))
