"""Weights of edges from the standard deviations of normals."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from acquisition import DataError

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

# Of normals whose deviations are not known, relative to a prior.
ASSUMED_SIGMA_DEG = 1.0
# Smaller deviations, relative to the median, count as this: the model has errors too.
LEAST_SIGMA = 0.1


def variances(sigma_deg: Float | None, mask: Mask) -> tuple[Float | None, float]:
    """Return the variances of normals relative to their median, and the median.

    Parameters
    ----------
    sigma_deg
        ``(H, W)`` root mean square angle to the true normal, both tangent directions together. A
        normal whose deviation is NaN counts as the least certain one.
    mask
        ``(H, W)`` bool, the pixels with a normal.

    Returns
    -------
    relative
        ``(H, W)`` float32, 1 outside the mask; None if no deviation is known.
    median
        Variance in each tangent direction in rad^2; if no deviation is known, that of 1 degree.

    Raises
    ------
    DataError
        If the shapes differ, or a deviation is negative or infinite.
    """
    if sigma_deg is not None and sigma_deg.shape != mask.shape:
        raise DataError(
            f"deviations of shape {sigma_deg.shape} do not fit normals of shape {mask.shape}"
        )
    inside = np.zeros(0, np.float32) if sigma_deg is None else sigma_deg[mask]
    if (inside < 0).any() or np.isinf(inside).any():
        raise DataError("standard deviations of normals are negative or infinite: give degrees")
    middle = float(np.nanmedian(inside)) if np.isfinite(inside).any() else 0.0
    if middle == 0:
        return None, np.radians(ASSUMED_SIGMA_DEG) ** 2 / 2
    filled = np.maximum(np.nan_to_num(inside, nan=float(np.nanmax(inside))), LEAST_SIGMA * middle)
    relative = np.ones(mask.shape, np.float32)
    relative[mask] = np.square(filled / middle)
    return relative, np.radians(middle) ** 2 / 2


def certainties(relative: Float) -> tuple[Float, Float]:
    """Return the reciprocal of the mean variance of both normals of each edge.

    Parameters
    ----------
    relative
        ``(H, W)`` float32 variances.

    Returns
    -------
    right, down
        ``(H+2, W+2)`` float32 factors for weights of edges, 1 at the border.
    """
    right, down = np.ones((2, relative.shape[0] + 2, relative.shape[1] + 2), np.float32)
    right[1:-1, 1:-2] = 2 / (relative[:, :-1] + relative[:, 1:])
    down[1:-2, 1:-1] = 2 / (relative[:-1] + relative[1:])
    return right, down
