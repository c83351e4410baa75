"""Individuals charts: single values in the order of time, with control limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from rig.arrays import Bool, Float64
from sgp.pictures.lights import short_names
from sgp.pictures.sheet import Panel, set_plot_area

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Mean range of two values of a normal distribution, in standard deviations (d2 of ISO 7870-2).
_MEAN_RANGE: Final = 1.128
_FEWEST: Final = 3
_ASPECT: Final = 1.6
_NAMES: Final = 24  # that fit on an axis


class ControlLimits(NamedTuple):
    """Centre line and limits of an individuals chart."""

    centre: float
    low: float
    high: float


def individuals_limits(values: Float64) -> ControlLimits | None:
    """Return the mean of values in the order of time, less and plus 3 sigma.

    Sigma is the mean range of neighbours divided by 1.128 (ISO 7870-2); None with fewer than three
    values.
    """
    if len(values) < _FEWEST:
        return None
    centre = float(values.mean())
    reach = 3 * float(np.abs(np.diff(values)).mean()) / _MEAN_RANGE
    return ControlLimits(centre, centre - reach, centre + reach)


@dataclass(frozen=True, eq=False)
class Series:
    """Values of one parameter of N parts, in the order of time.

    Parameters
    ----------
    title
        What it is, with its unit.
    names
        Names of the parts.
    values, expanded
        ``(N,)`` values and their expanded uncertainties (k = 2); NaN if these are not known.
    exceeded
        ``(N,)`` bool, parts that exceed a limit of the specification.
    specified
        The limits of the specification.
    """

    title: str
    names: Sequence[str]
    values: Float64
    expanded: Float64
    exceeded: Bool
    specified: Sequence[float] = field(default=())

    @property
    def marked(self) -> Bool:
        """``(N,)`` bool, parts beyond a control limit or a limit of the specification."""
        limits = individuals_limits(self.values)
        if limits is None:
            return self.exceeded
        outside: Bool = (self.values < limits.low) | (self.values > limits.high)
        return self.exceeded | outside


def control_panel(series: Series) -> Panel:
    """Show a series: marked parts are red, limits of the specification are lines in red."""

    def draw(axes: Axes) -> None:
        set_plot_area(axes)
        where, marked = np.arange(len(series.values)), series.marked
        axes.errorbar(
            where, series.values, np.nan_to_num(series.expanded),
            fmt="o-", ms=4, lw=0.8, capsize=2, color="tab:blue", ecolor="0.5",
        )  # fmt: skip
        axes.plot(where[marked], series.values[marked], "o", ms=7, color="tab:red", zorder=3)
        limits = individuals_limits(series.values)
        if limits is not None:
            axes.axhline(limits.centre, color="0.3", lw=0.8)
            for one in (limits.low, limits.high):
                axes.axhline(one, color="0.3", lw=0.8, ls="--")
        for one in series.specified:
            axes.axhline(one, color="tab:red", lw=1.2)
        axes.set_xlim(-0.6, len(where) - 0.4)
        step = -(-len(where) // _NAMES)
        axes.set_xticks(where[::step], short_names(series.names)[::step], rotation=90)
        axes.tick_params(labelsize=7)

    return Panel(series.title, draw, _ASPECT)
