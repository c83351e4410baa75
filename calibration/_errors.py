"""The errors that calibration raises."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar

from acquisition import DataError
from rig import SgpError

P = ParamSpec("P")
T = TypeVar("T")

__all__ = ["DataError", "EstimateError", "or_none"]


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


def or_none(estimate: Callable[P, T], *args: P.args, **options: P.kwargs) -> T | None:
    """Return what a function estimates; None if it raises `EstimateError`."""
    try:
        return estimate(*args, **options)
    except EstimateError:
        return None
