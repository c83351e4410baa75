"""Whether normals at the outline of an object point outward, as those of most objects do."""

from __future__ import annotations

import cv2
import numpy as np

from processing.checks import limits
from processing.checks.verdict import Cause
from processing.maps.normal_map import NormalMap
from rig.arrays import Float64

# Width of the outline, in cells.
_WIDTH = 2.0
_MARGIN = 4


def outward(normals: NormalMap) -> Float64 | None:
    """Return how much the normals at the outline point outward along x and y, -1..1.

    None if they are not steep there, as those of flat reliefs.
    """
    inside = np.pad(normals.mask, _MARGIN)
    vectors = np.pad(
        np.where(normals.mask[..., None], normals.normals, 0), [(_MARGIN,) * 2] * 2 + [(0, 0)]
    )
    down, right = np.gradient(cv2.GaussianBlur(inside.astype(np.float32), (0, 0), _WIDTH))
    slope = np.stack([-right, down], axis=-1)  # y is up
    size = np.linalg.norm(slope, axis=2)
    outline = inside & (size > 0.5 * size.max())
    across = vectors[outline][:, :2].astype(np.float64)
    if not outline.any() or np.median(np.linalg.norm(across, axis=1)) < limits.STEEP:
        return None
    products = across * slope[outline] / size[outline][:, None]
    return np.asarray(products.sum(axis=0) / np.maximum(np.abs(products).sum(axis=0), 1e-12))


def inward(shares: Float64 | None) -> Cause | None:
    """Return the cause if the normals at the outline point inward along one or both axes."""
    if shares is None or not (shares < -limits.INWARD).any():
        return None
    if (shares < -limits.INWARD).all():
        text = (
            "the normals at the outline of the object point inward: the images or the lights are "
            "upside down and the relief is inverted, or the object is hollow"
        )
        return Cause("images-turned", text, remedy="turn the images, or the lights")
    axis = "left to right" if shares[0] < 0 else "top to bottom"
    text = (
        f"the normals at the outline of the object point inward {axis}, and outward in the other "
        "direction: the lights or the images are mirrored, or the mask cuts the object"
    )
    return Cause("lights-mirrored", text, remedy="check the axes of the lights")
