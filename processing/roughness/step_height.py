"""Height of a step and depth of a groove along a line (ISO 5436-1)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from calibration import EstimateError
from processing.roughness.areal_parameters import Parameter
from rig.arrays import Bool, Float64

STEP: Final[Mapping[str, Parameter]] = {
    "d": Parameter("height", "um", "height of the step or groove, negative if it falls", False),
    "W": Parameter("length", "mm", "width of the groove at half of its depth", False),
    "flank": Parameter("length", "mm", "width of the narrowest flank", False),
}
# The flanks of a groove differ by less than this factor.
_PAIR = 0.5
# Share of the width of a groove on both sides of an edge that does not count.
_IGNORED = 1 / 3
_FEWEST = 5


@dataclass(frozen=True)
class Step:
    """A step or a groove.

    Parameters
    ----------
    kind
        ``step``, or ``groove`` (also one that is raised).
    height
        Height of the side at the end of the line above that at its beginning, or of the groove
        above its sides (negative for a groove that is sunk), in the unit of the heights.
    width_px
        Width of the groove at half of its depth, in pixels; NaN for a step.
    flank_px
        Width of the narrowest flank: its height divided by its steepest slope.
    """

    kind: Literal["step", "groove"]
    height: float
    width_px: float
    flank_px: float


def step_height(heights: Float64, rounded: float = 1.0) -> Step:
    """Return the step or groove of a profile.

    Two parallel lines are fitted by least squares. For a groove of width W, the lower one counts
    over its middle third, and the upper one over two thirds of W on either side, a third of W away
    from its edges (ISO 5436-1, type A1). For a single step, both count from one width of the flank
    on either side of it.

    Parameters
    ----------
    heights
        ``(N,)`` finite.
    rounded
        Widths of a flank, from its middle, that do not count on either side of a step.

    Raises
    ------
    EstimateError
        If no flank is steeper than the rest, or too few heights are left on one side.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.roughness import step_height
    >>> heights = np.clip((np.arange(100) - 50) / 10, -1, 1)
    >>> found = step_height(heights)
    >>> found.kind, round(found.height, 6)
    ('step', 2.0)
    """
    slopes = np.gradient(heights)
    slopes = slopes - np.median(slopes)
    flanks = sorted(_flanks(slopes), key=lambda one: -abs(one.rise))
    main = flanks[0]
    others = [
        one
        for one in flanks[1:]
        if one.rise * main.rise < 0 and abs(one.rise) > _PAIR * abs(main.rise)
    ]
    at = np.arange(len(heights), dtype=np.float64)
    if not others:
        apart = rounded * main.width + 1
        after = at > main.middle + apart
        before = at < main.middle - apart
        return Step("step", _difference(heights, at, after, before | after), math.nan, main.width)
    first, second = sorted((main, others[0]), key=lambda one: one.middle)
    width = second.middle - first.middle
    middle = (first.middle + second.middle) / 2
    away = np.abs(at - middle)
    inner = away <= width / 6
    outer = (away >= width * (0.5 + _IGNORED)) & (away <= 1.5 * width)
    return Step(
        "groove",
        _difference(heights, at, inner, inner | outer),
        width,
        min(first.width, second.width),
    )


@dataclass(frozen=True)
class _Flank:
    """Where a profile rises or falls: its middle, equivalent width, and the change of height."""

    middle: float
    width: float
    rise: float


def _flanks(slopes: Float64) -> list[_Flank]:
    """Return connected parts with the same sign of the slope around each that is steep."""
    steep = np.abs(slopes) > 0.5 * np.abs(slopes).max()
    if not np.abs(slopes).max() > 0:
        raise EstimateError("the profile has no step: it is flat")
    found, used = list[_Flank](), np.zeros(len(slopes), np.bool_)
    for start in np.flatnonzero(steep):
        if used[start]:
            continue
        sign = np.sign(slopes[start])
        limit = 0.1 * np.abs(slopes).max()
        first = last = int(start)
        while first > 0 and sign * slopes[first - 1] > limit:
            first -= 1
        while last < len(slopes) - 1 and sign * slopes[last + 1] > limit:
            last += 1
        used[first : last + 1] = True
        part = slopes[first : last + 1]
        rise = float(part.sum())
        middle = float((part * np.arange(first, last + 1)).sum() / rise)
        found.append(_Flank(middle, abs(rise) / float(np.abs(part).max()), rise))
    return found


def _difference(heights: Float64, at: Float64, raised: Bool, used: Bool) -> float:
    """Return by how much the line of some heights is above that of the others, parallel to it."""
    if min(np.count_nonzero(used & raised), np.count_nonzero(used & ~raised)) < _FEWEST:
        raise EstimateError(
            f"fewer than {_FEWEST} pixels are left on one side of the step: use a longer line"
        )
    matrix = np.column_stack([at[used], np.ones(np.count_nonzero(used)), raised[used]])
    return float(np.linalg.lstsq(matrix, heights[used], rcond=None)[0][2])
