"""Kinds of samples, and reasons why a pixel has no valid normal."""

from __future__ import annotations

from enum import IntEnum


class SampleKind(IntEnum):
    """What a sample shows; the order is that of the maps of counts.

    `LIT` samples agree with a Lambertian surface. The surface faces away from the light of an
    `ATTACHED` one, something else blocks the light of a `CAST` one, and an `OUTLIER` contradicts
    the others: a highlight, or light from elsewhere. `MISSING` are samples of near lights that
    shine in another direction.
    """

    LIT = 0
    ATTACHED = 1
    CAST = 2
    SATURATED = 3
    OUTLIER = 4
    MISSING = 5


class Reason(IntEnum):
    """Why a pixel has no valid normal; the values are the samples of ``invalid.png``."""

    OUTSIDE = 0
    VALID = 1
    SATURATED = 2
    SHADOW = 3
    OUTLIERS = 4
    COPLANAR = 5
    UNSOLVED = 6
