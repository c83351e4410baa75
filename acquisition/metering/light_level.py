"""Light level of a frame, and the exposure that would bring it to the target level."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from acquisition._errors import DataError
from rig.arrays import UInt16

# Relative deviation from the target level that is accepted.
_TOLERANCE = 0.02
# If saturation limits the exposure, the tail of the histogram is placed at this share of full
# scale, so that noise does not saturate it.
_TAIL = 0.95
# Noise alone may look like light, so the exposure grows by at most this factor per step.
_LARGEST_STEP = 32.0
_STEPS_PER_DECADE = 96


@dataclass(frozen=True)
class MeteringGoal:
    """Target of metering.

    Parameters
    ----------
    percentile
        Percentile of raw values above black, over the full frame, to place at the target level;
        above 0 to 100.
    fraction
        Target level as a share of the range from black to white, above 0 and at most 0.95.
    max_clipped_fraction
        Largest share of saturated samples, 0 to 1. It takes precedence if it requires a shorter
        exposure than the percentile.
    each
        True for a separate exposure per light, False for one exposure that suits the brightest.
    start_us
        First exposure to try, microseconds.
    longest_us
        Longest exposure to choose, microseconds. An LED without light up to this exposure is dead.

    Raises
    ------
    DataError
        If a value is outside its range.
    """

    percentile: float = 99.5
    fraction: float = 0.7
    max_clipped_fraction: float = 0.005
    each: bool = True
    start_us: float = 10_000.0
    longest_us: float = 1_000_000.0

    def __post_init__(self) -> None:
        ranges = (
            ("percentile", 0 < self.percentile <= 100, "above 0 to 100"),
            ("fraction", 0 < self.fraction <= _TAIL, f"above 0 to {_TAIL}"),
            ("max_clipped_fraction", 0 <= self.max_clipped_fraction <= 1, "0 to 1"),
            ("start_us", 0 < self.start_us < math.inf, "above 0"),
            ("longest_us", 0 < self.longest_us < math.inf, "above 0"),
        )
        for name, fits, allowed in ranges:
            if not fits:
                raise DataError(
                    f"metering: {name} is {getattr(self, name):g}, the range is {allowed}"
                )


@dataclass(frozen=True)
class LightLevel:
    """Light level of one frame, in grey values above black.

    Parameters
    ----------
    exposure_us
        Exposure time of the frame.
    level_dn
        The goal's percentile: the smallest value that at least this share of samples does not
        exceed.
    tail_dn
        Quantile at 1 minus the goal's ``max_clipped_fraction``.
    mean_dn
        Mean.
    clipped_fraction
        Share of samples at or above white.
    """

    exposure_us: float
    level_dn: float
    tail_dn: float
    mean_dn: float
    clipped_fraction: float


def light_level(
    pixels: UInt16,
    exposure_us: float,
    goal: MeteringGoal,
    *,
    black_dn: float,
    white_dn: float,
) -> LightLevel:
    """Measure a raw frame, ``(H, W)`` or ``(H, W, 3)``, over all its samples."""
    counts = np.bincount(pixels.ravel(), minlength=65536)
    ranks = np.cumsum(counts)
    total = int(ranks[-1])

    def quantile_dn(share: float) -> float:
        return float(np.searchsorted(ranks, math.ceil(share * total))) - black_dn

    return LightLevel(
        exposure_us,
        quantile_dn(goal.percentile / 100),
        quantile_dn(1 - goal.max_clipped_fraction),
        float(counts @ np.arange(65536)) / total - black_dn,
        float(counts[math.ceil(white_dn) :].sum() / total),
    )


def reached(level: LightLevel, goal: MeteringGoal, span_dn: float) -> bool:
    """Return whether a frame is at the target level; ``span_dn`` is white minus black."""
    return (
        level.clipped_fraction <= goal.max_clipped_fraction
        and abs(level.level_dn / (goal.fraction * span_dn) - 1) <= _TOLERANCE
    )


def better_exposure_us(level: LightLevel, goal: MeteringGoal, span_dn: float) -> float:
    """Return the exposure that should bring a frame to the target level.

    Grey values above black are proportional to the exposure, so it follows from one frame. A
    saturated frame only shows that less is needed: its exposure is halved, or divided by eight if
    most of the frame is saturated.
    """
    if level.clipped_fraction > goal.max_clipped_fraction or level.level_dn >= span_dn:
        return level.exposure_us / (8 if level.clipped_fraction > 0.5 else 2)
    by_level = goal.fraction * span_dn / max(level.level_dn, 1e-9)
    by_tail = _TAIL * span_dn / max(level.tail_dn, 1e-9)
    return level.exposure_us * min(by_level, by_tail, _LARGEST_STEP)


def stepped_us(exposure_us: float, low_us: float, high_us: float) -> float:
    """Return the nearest of 96 exposures per decade (the E96 series) within a range.

    Lights that differ by less than 2.4 % then share an exposure and so a dark frame.
    """
    if exposure_us <= low_us:
        return low_us
    if exposure_us >= high_us:
        return high_us
    exact = 10 ** (round(math.log10(exposure_us) * _STEPS_PER_DECADE) / _STEPS_PER_DECADE)
    digits = 2 - math.floor(math.log10(exact))
    return min(max(round(exact, digits), low_us), high_us)
