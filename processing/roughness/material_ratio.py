"""The material ratio curve and its parameters (ISO 25178-2, ISO 21920-2)."""

from __future__ import annotations

import math

import numpy as np

from rig.arrays import Floating

# Share of the curve through which the equivalent line goes, and the heights of Sxp and Smr.
_CORE = 0.4
_PEAKS, _HALF = 0.025, 0.5
_ABOVE_UM = 1.0
# Places at which the line may begin.
_PLACES = 2_000
# Heights whose sums are computed at once.
_BAND = 1_000_000


def material_ratio(ascending_um: Floating, letter: str = "S") -> dict[str, float]:
    """Return Sk, Spk, Svk, Smr1, Smr2, Sxp and Smr of heights about their mean.

    The equivalent line is that of least squares over the 40 % of the material ratio curve whose
    secant is least steep. Spk and Svk are the heights of triangles of the same area as what is
    beyond the core.

    Parameters
    ----------
    ascending_um
        ``(N,)`` heights in um, ascending; they are taken for a continuous curve.
    letter
        First letter of the names.
    """
    names = ("k", "pk", "vk", "mr1", "mr2", "xp", "mr")
    count = len(ascending_um)
    if count < 10 or ascending_um[-1] == ascending_um[0]:
        return dict.fromkeys((letter + name for name in names), math.nan)
    heights = ascending_um[::-1]
    core = max(2, round(_CORE * count))
    first = np.unique(np.linspace(0, count - core, min(_PLACES, count - core + 1)).astype(int))
    drop = heights[first] - heights[first + core - 1]
    # Where the slope is the same in several places, the middle one counts.
    flattest = first[drop <= drop.min() * (1 + 1e-12)]
    start = int(flattest[len(flattest) // 2])
    slope, at_zero = _line(heights[start : start + core], (start + 0.5) / count, 1 / count)
    top, bottom = at_zero, at_zero + slope
    above = count - int(np.searchsorted(ascending_um, top, side="right"))
    below = count - int(np.searchsorted(ascending_um, bottom, side="right"))
    peaks, dales = above / count, below / count
    area_peaks = float((heights[:above] - top).sum(dtype=np.float64)) / count
    area_dales = float((bottom - heights[below:]).sum(dtype=np.float64)) / count
    highest, middle = (_at(heights, share * count - 0.5) for share in (_PEAKS, _HALF))
    values = (
        top - bottom,
        2 * area_peaks / peaks if peaks > 0 else 0.0,
        2 * area_dales / (1 - dales) if dales < 1 else 0.0,
        100 * peaks,
        100 * dales,
        highest - middle,
        100 * (1 - float(np.searchsorted(ascending_um, _ABOVE_UM)) / count),
    )
    return dict(zip((letter + name for name in names), values, strict=True))


def _line(heights: Floating, first: float, step: float) -> tuple[float, float]:
    """Return slope and height at 0 of the line of least squares through evenly spaced heights."""
    count = len(heights)
    middle, mean = first + step * (count - 1) / 2, float(heights.mean(dtype=np.float64))
    moment = 0.0
    for at in range(0, count, _BAND):
        part = heights[at : at + _BAND]
        moment += float((np.arange(at, at + len(part)) - (count - 1) / 2) @ part)
    # The sum of the squared distances from the middle is count (count^2 - 1) / 12.
    slope = moment / (count * (count**2 - 1) / 12 * step)
    return slope, mean - slope * middle


def _at(heights: Floating, place: float) -> float:
    """Return the height at a place of the curve, by linear interpolation."""
    first = min(max(int(place), 0), len(heights) - 2)
    share = min(max(place - first, 0.0), 1.0)
    return float((1 - share) * heights[first] + share * heights[first + 1])
