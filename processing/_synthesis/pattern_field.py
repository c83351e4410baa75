"""The map from the image to the exemplar around each pixel of a target."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt

from processing._normal_map import NormalMap

Float = npt.NDArray[np.float32]

# Largest stretch along the tilt: 75.5 degrees.
_MOST_STRETCH = 4.0


class PatternField(NamedTuple):
    """The map from steps in the image to steps in the exemplar.

    Parameters
    ----------
    steps
        ``(H, W, 2, 2)`` float32: (down, right) in the exemplar for one pixel (down, right) in the
        image.
    turn
        ``(H, W)`` float32: angle in rad, counter-clockwise, from the x axis of the detail's frame
        to that of the pattern.
    """

    steps: Float
    turn: Float


def pattern_field(
    shape: NormalMap,
    *,
    image_space: bool = False,
    direction_deg: Float | None = None,
    scale: Float | None = None,
) -> PatternField:
    """Return the map from a target to a pattern that follows arc length on its surface.

    A step d in the image is the step J d in the tangent plane, in the axes that the shortest
    rotation from z to the normal s makes of x and y: ``J = I + s s^T / (s_z (1 + s_z))`` with
    s = (s_x, s_y). It stretches by 1 / s_z along the tilt, and by 1 across it.

    Parameters
    ----------
    shape
        Shape component of the target. Pixels outside its mask have the map of the nearest pixel
        inside.
    image_space
        The pattern follows the image instead: J is the identity.
    direction_deg
        ``(H, W)`` direction in the image that the x axis of the pattern follows, counter-clockwise
        from X; finite on the mask.
    scale
        ``(H, W)`` size of the pattern relative to the exemplar; positive on the mask.
    """
    normals = shape.normals.astype(np.float64)
    z = np.maximum(normals[..., 2], 1 / _MOST_STRETCH)
    # Down instead of up. Beyond the limit, the direction of the tilt is kept.
    tilt = np.stack([-normals[..., 1], normals[..., 0]], axis=-1)
    most = np.sqrt(1 - z * z)
    tilt *= (most / np.maximum(np.hypot(*np.moveaxis(tilt, -1, 0)), most + 1e-12))[..., None]
    jacobian = np.zeros((*shape.size, 2, 2))
    jacobian[...] = np.eye(2)
    if not image_space:
        jacobian += tilt[..., :, None] * tilt[..., None, :] / (z * (1 + z))[..., None, None]
    turn = np.zeros(shape.size)
    if direction_deg is not None:
        angle = np.radians(np.where(shape.mask, direction_deg, 0))
        step = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
        down, right = np.moveaxis(np.einsum("...ij,...j", jacobian, step), -1, 0)
        turn = np.arctan2(-down, right)
        c, s = np.cos(turn), np.sin(turn)
        # Counter-clockwise by -turn, in (down, right).
        rotation = np.stack([np.stack([c, s], -1), np.stack([-s, c], -1)], -2)
        jacobian = rotation @ jacobian
    if scale is not None:
        jacobian /= np.where(shape.mask, scale, 1)[..., None, None]
    y, x = distance_transform_edt(~shape.mask, return_distances=False, return_indices=True)
    return PatternField(jacobian[y, x].astype(np.float32), turn[y, x].astype(np.float32))
