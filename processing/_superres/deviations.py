"""What the deviations that a network predicts have turned out to be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float32]

_LEAST = 1e-16  # radian^2


@dataclass(frozen=True)
class Deviations:
    """Actual deviations for predicted ones, measured on surfaces that were not trained on.

    A network extrapolates the logarithm of its mean-square error, which has no limits. The
    correction is linear in logarithms between the given values, has the last one as its limit, and
    the ratio of the first ones below them.

    Parameters
    ----------
    predicted_deg
        Predicted standard deviations in degrees, increasing, two or more.
    actual_deg
        Root mean square errors of pixels with these predictions, in degrees; none is smaller than
        the one before.

    Raises
    ------
    ValueError
        If they are not such values.

    Examples
    --------
    >>> from processing import Deviations
    >>> Deviations((0.1, 1, 10), (0.2, 1, 5)).corrected_deg([0.05, 1, 40]).round(3)
    array([0.1, 1. , 5. ], dtype=float32)
    """

    predicted_deg: tuple[float, ...]
    actual_deg: tuple[float, ...]

    def __post_init__(self) -> None:
        predicted, actual = (np.array(one) for one in (self.predicted_deg, self.actual_deg))
        good = len(predicted) == len(actual) > 1 and min(predicted[0], actual[0]) > 0
        if not (good and (np.diff(predicted) > 0).all() and (np.diff(actual) >= 0).all()):
            raise ValueError(
                "the predicted and actual deviations are not two rows of as many positive values, "
                "the predicted ones increasing and the actual ones not decreasing"
            )
        if not (np.isfinite(predicted).all() and np.isfinite(actual).all()):
            raise ValueError("a predicted or actual deviation is not finite")

    def corrected_deg(self, predicted_deg: npt.ArrayLike) -> Float:
        """Return actual deviations in degrees for predicted ones."""
        variance = np.radians(np.asarray(predicted_deg, np.float32)) ** 2
        return np.asarray(np.degrees(np.sqrt(self.corrected(variance))), np.float32)

    def corrected(self, variance: Float) -> Float:
        """Return actual for predicted mean-square errors, in radians squared."""
        known, actual = (
            2 * np.log(np.radians(one)) for one in (self.predicted_deg, self.actual_deg)
        )
        logs = np.log(np.maximum(variance, _LEAST))
        below = np.minimum(logs - known[0], 0)
        return np.asarray(np.exp(np.interp(logs, known, actual) + below), np.float32)
