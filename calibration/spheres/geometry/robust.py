"""Robust least squares with Tukey's biweight."""

from __future__ import annotations

import numpy as np

from calibration._errors import EstimateError
from rig.arrays import Float64, Floating

# Number of reweighting rounds.
ROUNDS = 10
# No outline is known better than this; a smaller scale would reject good points.
FINEST_PX = 0.15


def middle_of(values: Floating) -> float:
    """Return the median of numbers ``(...)``, which are not NaN: faster than `numpy.median`."""
    half = values.size // 2
    ordered = np.partition(values, half, axis=None)
    if values.size % 2:
        return float(ordered[half])
    return float(ordered[:half].max() + ordered[half]) / 2


def tukey_weights(residual: Float64, finest: float) -> Float64:
    """Return biweights whose scale is the scaled median absolute residual, at least `finest`."""
    scale = max(1.4826 * middle_of(np.abs(residual)), finest)
    part = residual / (4.685 * scale)
    part *= part
    weights: Float64 = np.maximum(1 - part, 0)
    weights *= weights
    return weights


def check_enough(weights: Float64, count: int, what: str) -> None:
    """Raise `EstimateError` if fewer than ``count`` weights are positive; ``what`` is the shape."""
    left = int(np.sum(weights > 0))
    if left < count:
        raise EstimateError(f"{left} outline points do not determine {what}: check the outline")


def weighted_solve(design: Float64, target: Float64, weights: Float64) -> Float64:
    """Solve ``design @ x = target`` with ``(M, P)`` weighted rows by least squares."""
    root = np.sqrt(weights)
    solution = np.linalg.lstsq(design * root[:, None], target * root, rcond=None)[0]
    return np.asarray(solution, np.float64)
