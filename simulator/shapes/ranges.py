"""Checks that the numbers of a scene are within their ranges; messages name owner and value."""

from __future__ import annotations

import math

import numpy as np

from acquisition import DataError

Albedo = float | tuple[float, float, float]


def check_positive(owner: str, *, what: str = "positive", **values: float | None) -> None:
    """Check that numbers are finite and greater than 0; ``what`` is what they must be.

    Raises
    ------
    DataError
        If one is not.
    """
    for name, value in values.items():
        if value is None or not (math.isfinite(value) and value > 0):
            raise DataError(f"{owner}: {name} is {value}, it must be {what}")


def check_length(owner: str, **values: float) -> None:
    """Check that lengths are finite and positive, see `check_positive`."""
    check_positive(owner, what="a positive length in mm", **values)


def check_within(owner: str, low: float, high: float, **values: float) -> None:
    """Check that numbers are within ``low`` to ``high``, both included.

    Raises
    ------
    DataError
        If one is not.
    """
    for name, value in values.items():
        if not low <= value <= high:
            raise DataError(f"{owner}: {name} is {value}, it must be within {low:g}..{high:g}")


def check_albedo(owner: str, **values: Albedo) -> None:
    """Check that albedos are one or three numbers within 0..1.

    Raises
    ------
    DataError
        If one is not.
    """
    for name, value in values.items():
        levels = np.asarray(value, np.float64)
        if levels.shape not in ((), (3,)) or not np.all((levels >= 0) & (levels <= 1)):
            raise DataError(f"{owner}: {name} is {value}, it must be one or three numbers in 0..1")
