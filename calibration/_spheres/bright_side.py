"""Whether an outline is seen where its surroundings are bright."""

from __future__ import annotations

import cv2
import numpy as np

from calibration._radiance.raw_stack import Images
from calibration._spheres.ellipse import Ellipse
from calibration._spheres.image_noise import image_noise
from calibration._spheres.joint_edge import edge_agreement

# The surroundings are what is seen at these multiples of the radius, under the brighter lights.
_RINGS, _BRIGHTER_PERCENT = (1.1, 1.2, 1.3), 90
# They are black below so many standard deviations of the noise, and below this share of white.
_BLACK_SIGMAS, _BLACK = 10.0, 0.01
_LEAST_SHARE = 0.2


def bright_support(images: Images, outline: Ellipse) -> float:
    """Return the support of an outline where its surroundings are bright.

    A ball on a black cloth mirrors the border of the cloth as a sharp circle inside its outline,
    and looks like the cloth outside of this circle. Where the surroundings are bright, they are
    brighter than their mirror image, so that the outline is seen there, and the circle is not.

    Parameters
    ----------
    images
        ``(N, H, W)`` linear images, 1 is white, not NaN.
    outline
        An outline from `joint_outline`.

    Returns
    -------
    float
        Share 0..1 of the bright part of the circumference where an edge agrees with the outline, by
        its distance; NaN if less than a fifth of the circumference is bright.
    """
    angles, agreement = edge_agreement(images, outline)
    around = np.stack([outline.point(angles, ring) for ring in _RINGS]).astype(np.float32)
    x, y = np.ascontiguousarray(around[..., 0]), np.ascontiguousarray(around[..., 1])
    height, width = images.shape[1:]
    inside = np.all((x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1), axis=0)
    each = [images[k] for k in range(len(images))]
    seen = [cv2.remap(image, x, y, cv2.INTER_LINEAR) for image in each]
    level = np.median(np.percentile(seen, _BRIGHTER_PERCENT, axis=0), axis=0)
    noise = float(np.median([image_noise(image) for image in each]))
    bright = inside & (level > max(_BLACK_SIGMAS * noise, _BLACK))
    if bright.mean() < _LEAST_SHARE:
        return float("nan")
    return float(agreement[bright].mean())
