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

# Chosen on drawn scenes of overlapping caps with relief, where the bands along edges lose half of
# what the Gaussian leaves there and the relief elsewhere keeps most of its angle. The second pass,
# led by the shape of the first, mends edges that the first guide has rounded.
_PASSES = 2
_REACH = 0.8  # of w: the guided filter's radius, the bilateral filter's sigma
_GUIDED_EPSILON = 0.004
_BILATERAL_RANGE = 0.2


def smooth_within_edges(
    kind: Literal["guided", "bilateral"], normals: Float, mask: Mask, guide: Float, w: int
) -> Float:
    """Smooth normals where the guide is smooth.

    Parameters
    ----------
    kind
        ``guided``: the normals are fitted as a linear function of the guide in windows of 0.8 w to
        either side (He et al., 2010). ``bilateral``: a Gaussian of sigma 0.8 w, less weight to
        pixels whose guide differs by more than 0.2 (joint bilateral filter, Petschnigg et al.,
        2004); it is the stricter one at edges, and takes away more of strong relief.
    normals, guide
        ``(H, W, 3)`` unit vectors, 0 outside the mask: the map and its Gaussian shape.
    mask
        ``(H, W)``.
    w
        Half width of the Gaussian's window in pixels.

    Returns
    -------
    Float
        ``(H, W, 3)`` means, not of unit length, and smeared over the mask's border.
    """
    reach = _REACH * w
    smooth = guide
    for _ in range(_PASSES):
        if smooth is not guide:
            length = np.linalg.norm(smooth, axis=2, keepdims=True)
            smooth = np.where(mask[..., None], smooth / np.maximum(length, np.float32(1e-6)), 0)
            smooth = smooth.astype(np.float32)
        smooth = np.asarray(
            cv2.ximgproc.guidedFilter(smooth, normals, max(1, round(reach)), _GUIDED_EPSILON)
            if kind == "guided"
            else cv2.ximgproc.jointBilateralFilter(
                smooth, normals, -1, _BILATERAL_RANGE, reach, borderType=cv2.BORDER_REFLECT_101
            ),
            np.float32,
        )
    return smooth
