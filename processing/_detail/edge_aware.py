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

# Chosen on drawn scenes of occlusions, folds and faint to strong relief (w of 3, 5 and 8), so that
# the bands along edges keep less than half of what the Gaussian leaves there and the relief
# elsewhere more than three quarters of its angle. Filtering the rest once more takes out shape that
# one pass left in it.
_PASSES = 2
_GUIDED_REACH = 1.4  # of w
_GUIDED_EPSILON = 0.006
_BILATERAL_RANGE = 0.35


def leave_within_edges(
    kind: Literal["guided", "bilateral"], normals: Float, mask: Mask, guide: Float, w: int
) -> Float:
    """Return what smoothing leaves of normals where it mixes only what is alike in the guide.

    Parameters
    ----------
    kind
        ``guided``: the normals are fitted as a linear function of the guide in windows of 1.4 w to
        either side (He et al., 2010). ``bilateral``: a Gaussian of sigma w, less weight to pixels
        whose guide differs by more than 0.35 (joint bilateral filter, Petschnigg et al., 2004); it
        takes away more of strong relief. What either leaves is filtered once more.
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
    if kind == "guided":
        guided = cv2.ximgproc.createGuidedFilter(guide, round(_GUIDED_REACH * w), _GUIDED_EPSILON)
    rest = normals
    for _ in range(_PASSES):
        smooth = (
            guided.filter(rest)
            if kind == "guided"
            else cv2.ximgproc.jointBilateralFilter(
                guide, rest, -1, _BILATERAL_RANGE, w, borderType=cv2.BORDER_REFLECT_101
            )
        )
        # Smoothing smears over the mask's border; from there nothing may come back.
        rest = np.where(mask[..., None], rest - np.asarray(smooth, np.float32), np.float32(0))
    return rest
