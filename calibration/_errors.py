"""The errors that calibration raises."""

from acquisition import DataError
from rig import SgpError

__all__ = ["DataError", "EstimateError"]


class EstimateError(SgpError, ValueError):
    """Valid input does not determine the estimate; the message says why (exit code 5).

    Attributes
    ----------
    lights
        Names of the lights whose images cause it, if the others may be enough; else empty.
    spheres
        Circles (x, y, radius) in pixels of mirror spheres that were found nevertheless.
    """

    lights: tuple[str, ...] = ()
    spheres: tuple[tuple[float, float, float], ...] = ()
