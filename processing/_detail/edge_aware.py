"""Low-pass filters that stop at occlusions.

Where one surface ends before another, a Gaussian mixes the normals of both, and what it mixed is
left in the detail as a bright seam. These filters smooth under the guidance of the Gaussian's
shape: it has lost the detail but still tells the two sides of an edge apart. Outside the mask guide
and normals are 0, which is as far from a unit vector as the other side of an edge.
"""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
EdgeAware = Literal["guided", "bilateral"]

# Chosen on drawn scenes of occlusions, folds and faint to strong relief (w of 3, 5 and 8): little
# left in the bands along edges, against little of the relief lost elsewhere.
_GUIDED_REACH = 0.8  # of w
_GUIDED_EPSILON = 0.004
_BILATERAL_RANGE = 0.3


def leave_within_edges(kind: EdgeAware, normals: Float, mask: Mask, guide: Float, w: int) -> Float:
    """Return what smoothing leaves of normals where it mixes only what is alike in the guide.

    A first pass makes a better guide for the second: it mends edges that the Gaussian has rounded.

    Parameters
    ----------
    kind
        ``guided``: the normals are fitted as a linear function of the guide in windows of 0.8 w to
        either side (He et al., 2010). ``bilateral``: a Gaussian of sigma w, less weight to pixels
        whose guide differs by more than 0.3 (joint bilateral filter, Petschnigg et al., 2004). Its
        rest is filtered once more, as so wide a range leaves shape in it.
    normals, guide
        ``(H, W, 3)`` unit vectors, 0 outside the mask: the map and its Gaussian shape.
    mask
        ``(H, W)``.
    w
        Half width of the Gaussian's window in pixels.

    Returns
    -------
    Float
        ``(H, W, 3)`` normals less their smooth part, 0 outside the mask.
    """
    smooth = _smooth(kind, normals, mask, guide, w)
    length = np.linalg.norm(smooth, axis=2, keepdims=True)
    guide = smooth / np.maximum(length, np.float32(1e-6))
    rest = normals - _smooth(kind, normals, mask, guide, w)
    return rest - _smooth(kind, rest, mask, guide, w) if kind == "bilateral" else rest


def _smooth(kind: EdgeAware, vectors: Float, mask: Mask, guide: Float, w: int) -> Float:
    smooth = (
        cv2.ximgproc.guidedFilter(guide, vectors, round(_GUIDED_REACH * w), _GUIDED_EPSILON)
        if kind == "guided"
        else cv2.ximgproc.jointBilateralFilter(
            guide, vectors, -1, _BILATERAL_RANGE, w, borderType=cv2.BORDER_REFLECT_101
        )
    )
    # It smears over the mask's border, and from there nothing may come back.
    return np.where(mask[..., None], np.asarray(smooth, np.float32), np.float32(0))
