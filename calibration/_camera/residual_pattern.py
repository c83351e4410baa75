"""Whether residuals vary smoothly over views, which errors of single corners do not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from calibration._camera.view import BoardView

Array = npt.NDArray[np.float64]

_POSE = 6


def residual_pattern(views: Sequence[BoardView], residuals_px: Sequence[Array]) -> float:
    """Return how much residuals follow a quadratic function of the place in each view.

    Parameters
    ----------
    views
        Views with their corners.
    residuals_px
        ``(n, 2)`` residuals of each view after a fit of camera and poses.

    Returns
    -------
    float
        Variance of the part that is quadratic over that of the rest, per degree of freedom: 1 for
        independent errors of the corners, more if the camera's model does not fit.
    """
    smooth = rest = 0.0
    freedom = [0, 0]
    for view, residual in zip(views, residuals_px, strict=True):
        places = view.corners_px - view.corners_px.mean(axis=0)
        x, y = (places / np.abs(places).max()).T
        basis, _ = np.linalg.qr(np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1))
        part = basis @ (basis.T @ residual)
        smooth += float(np.sum(part**2))
        rest += float(np.sum((residual - part) ** 2))
        # The pose of the view has removed six of the twelve coefficients.
        freedom[0] += 2 * basis.shape[1] - _POSE
        freedom[1] += residual.size - 2 * basis.shape[1]
    if freedom[1] <= 0 or rest == 0:
        return 1.0
    return (smooth / freedom[0]) / (rest / freedom[1])
