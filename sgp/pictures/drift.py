"""Panels of a series of calibrations: common motion, and deviations in units of their limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

import calibration
from rig.arrays import Float64
from sgp.pictures.lights import short_names
from sgp.pictures.sheet import Panel, add_scale, set_plot_area

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ASPECT: Final = 0.75
# Names that fit on an axis.
_ROWS: Final = 40
_COLUMNS: Final = 14
# Colours end at this multiple of a limit.
_END: Final = 2.0


def drift_panels(drift: calibration.comparison.LightDrift, names: Sequence[str]) -> list[Panel]:
    """Return the charts of a series of calibrations with these names."""
    strengths = drift.strength_ratio
    panels = [
        _ratios("direction of each light without the common turn", drift, drift.direction_ratio),
        _ratios("strength of each light without the common factor", drift, strengths),
    ]
    if not np.isfinite(strengths).any():
        del panels[1]
    if np.isfinite(drift.common_ratio).all():
        panels.insert(0, _common(drift))
    return [_named(panel, short_names(names)) for panel in panels]


def _common(drift: calibration.comparison.LightDrift) -> Panel:
    def draw(axes: Axes) -> None:
        set_plot_area(axes)
        where, ratios = np.arange(len(drift.common_ratio)), drift.common_ratio
        axes.plot(where, ratios, "o-", color="tab:blue", ms=4, lw=1)
        axes.plot(where[ratios > 1], ratios[ratios > 1], "o", color="tab:red", ms=6)
        axes.axhline(1, color="tab:red", lw=1, ls="--")
        for place, ratio, turn in zip(where, ratios, drift.common_deg, strict=True):
            text = f"{turn:.2f}°"
            axes.annotate(
                text, (place, ratio), (0, 5), textcoords="offset points", fontsize=7, ha="center"
            )
        axes.set_ylim(0, 1.2 * max(1.2, float(ratios.max())))
        axes.set_xlim(-0.6, len(ratios) - 0.4)
        axes.set_ylabel("in units of its limit", fontsize=8)

    return Panel("motion that all lights have in common, and what it turns them by", draw, _ASPECT)


def _ratios(title: str, drift: calibration.comparison.LightDrift, ratios: Float64) -> Panel:
    """Show deviations ``(K, N)``, a row for each light; crosses are beyond a limit."""
    signed = bool(np.nanmin(ratios) < 0) if np.isfinite(ratios).any() else False

    def draw(axes: Axes) -> None:
        set_plot_area(axes)
        axes.set_facecolor("0.8")
        low, colours = (-_END, "coolwarm") if signed else (0.0, "Reds")
        shown = axes.imshow(ratios.T, cmap=colours, vmin=low, vmax=_END, aspect="auto")
        lights, columns = (np.abs(np.nan_to_num(ratios.T)) > 1).nonzero()
        axes.plot(columns, lights, "x", color="black", ms=4, mew=1)
        step = -(-len(drift.ids) // _ROWS)
        rows = range(0, len(drift.ids), step)
        axes.set_yticks(rows, short_names(drift.ids)[::step], fontsize=6.5)
        add_scale(axes, shown, "in units of its limit", "both" if signed else "max")

    return Panel(title, draw, _ASPECT)


def _named(panel: Panel, names: Sequence[str]) -> Panel:
    def draw(axes: Axes) -> None:
        panel.draw(axes)
        step = -(-len(names) // _COLUMNS)
        axes.set_xticks(range(0, len(names), step), names[::step], fontsize=7, rotation=90)
        axes.tick_params(axis="y", labelsize=6.5)

    return Panel(panel.title, draw, panel.aspect)
