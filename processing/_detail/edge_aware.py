"""Low-pass filters that stop at occlusions.

At an occlusion, a Gaussian mixes the normals of the two surfaces, which leaves a bright seam in the
detail. These filters are guided by the Gaussian's shape, which contains no detail but still
separates the two sides of an edge. Outside the mask, the guide and the normals are 0, which differs
from a unit vector as much as the other side of an edge does.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from processing._detail.filter_kind import FilterKind

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
EdgeAware = Literal["guided", "bilateral"]

# Chosen on synthetic scenes with occlusions, folds and weak to strong relief (w of 3, 5 and 8), as
# a compromise between a small residue along edges and a small loss of relief elsewhere.
_GUIDED_REACH = 0.8  # of w
_GUIDED_EPSILON = 0.004
_BILATERAL_RANGE = 0.3


def leave_within_edges(kind: EdgeAware, normals: Float, mask: Mask, guide: Float, w: int) -> Float:
    """Return the rest of the normals after smoothing that does not cross the edges of the guide.

    A first pass computes a better guide for the second: it restores edges that the Gaussian has
    rounded.

    Parameters
    ----------
    kind
        ``guided``: the normals are fitted as a linear function of the guide in windows of 0.8 w to
        either side (He et al., 2010). ``bilateral``: a Gaussian of sigma w that gives less weight
        to pixels whose guide differs by more than 0.3 (joint bilateral filter, Petschnigg et al.,
        2004). Its rest is filtered once more, because the wide range leaves shape in the rest.
    normals, guide
        ``(H, W, 3)`` unit vectors, 0 outside the mask: the map and its Gaussian shape.
    mask
        ``(H, W)``.
    w
        Half width of the Gaussian's window in pixels.

    Returns
    -------
    Float
        ``(H, W, 3)`` normals minus their smooth part, 0 outside the mask.
    """
    smooth = _smooth(kind, normals, mask, guide, w)
    length = np.linalg.norm(smooth, axis=2, keepdims=True)
    guide = smooth / np.maximum(length, np.float32(1e-6))
    rest = normals - _smooth(kind, normals, mask, guide, w)
    return rest - _smooth(kind, rest, mask, guide, w) if kind == "bilateral" else rest


def edge_reach(kind: FilterKind, w: int) -> int:
    """Return how many pixels `leave_within_edges` reaches."""
    # OpenCV's windows: two boxes in a row, in two passes; 1.5 sigma in three passes.
    return 4 * round(_GUIDED_REACH * w) if kind == "guided" else 3 * _bilateral_reach(w)


def _smooth(kind: EdgeAware, vectors: Float, mask: Mask, guide: Float, w: int) -> Float:
    import cv2  # late: other filters do not wait for it

    smooth = (
        cv2.ximgproc.guidedFilter(guide, vectors, round(_GUIDED_REACH * w), _GUIDED_EPSILON)
        if kind == "guided"
        else _bilateral(guide, vectors, w)
    )
    # Smoothing blurs across the border of the mask; the next pass must not use the values outside.
    return np.where(mask[..., None], np.asarray(smooth, np.float32), np.float32(0))


def _bilateral(guide: Float, vectors: Float, w: int) -> Float:
    """Smooth vectors with weights that do not depend on the part of a map that is given."""
    import cv2

    reach = _bilateral_reach(w)
    guide, vectors = (
        np.asarray(
            cv2.copyMakeBorder(part, reach, reach + 1, reach, reach, cv2.BORDER_REFLECT_101),
            np.float32,
        )
        for part in (guide, vectors)
    )
    # OpenCV tabulates its weights over the range of the guide. A row that no pixel reaches makes it
    # that of all unit vectors.
    guide[-1], guide[-1, 0] = -1, 1
    smooth = cv2.ximgproc.jointBilateralFilter(guide, vectors, -1, _BILATERAL_RANGE, w)
    return np.asarray(smooth, np.float32)[reach : -reach - 1, reach:-reach]


def _bilateral_reach(w: int) -> int:
    return round(1.5 * w)
