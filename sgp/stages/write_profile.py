"""Height profile of a result along its target, as the paper plots it."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

import acquisition
import processing
from rig import figure
from sgp.pictures import Panel, add_scale, set_plot_area, signed_panel, write_overview
from sgp.results import HeightProfileMetrics, Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ACROSS, _UP = 240, 160  # cells of the plot
_BEYOND: Final = 0.02  # of the range of heights, above and below
_STRAY: Final = 0.001  # share of the result that the plot leaves out at either end


def profile_panels(title: str, profile: processing.HeightProfile) -> list[Panel]:
    """Return a profile's plots, of all pixels and of their 5 x 5 means, and a map of differences.

    Pixels of the same target height share one place on the axis. If the result is shifted
    differently in two regions of the surface, the plot has two branches; the map shows the regions.
    """
    return [
        profile_panel(f"{title}, rms {figure(profile.rms, 3)} {profile.unit}", profile),
        profile_panel(
            f"5 x 5 means of the result, rms {figure(profile.smoothed_rms, 3)} {profile.unit}",
            profile,
            smoothed=True,
        ),
        signed_panel("where branches are: result minus target", profile.difference, profile.unit),
    ]


def profile_panel(
    title: str, profile: processing.HeightProfile, *, smoothed: bool = False
) -> Panel:
    """Plot how many pixels have which height, in ascending order of the target's heights.

    All pixels are counted, because single points would cover each other.
    """
    heights = profile.smoothed if smoothed else profile.result
    count = len(profile.target)
    ends = np.quantile(profile.result, [_STRAY, 1 - _STRAY])
    low, high = min(ends[0], profile.target[0]), max(ends[1], profile.target[-1])
    margin = _BEYOND * (high - low) or 1.0
    limits = low - margin, high + margin
    cells, _, _ = np.histogram2d(
        np.arange(count), heights, (_ACROSS, _UP), ((0, max(count, 2)), limits)
    )
    pick = profile.ranks()

    def draw(axes: Axes) -> None:
        from matplotlib.colors import LogNorm
        from matplotlib.ticker import EngFormatter, MaxNLocator

        set_plot_area(axes)
        most = max(float(cells.max()), 2.0)
        shown = axes.imshow(
            np.ma.masked_equal(cells.T, 0),
            origin="lower",
            aspect="auto",
            interpolation="nearest",
            extent=(0, max(count, 2), *limits),
            cmap="YlOrBr",
            norm=LogNorm(0.3, most),
        )
        axes.plot(pick, profile.target[pick], "-", color="white", lw=3)
        axes.plot(pick, profile.target[pick], "-", color="tab:blue", lw=1.5, label="target, sorted")
        axes.xaxis.set_major_locator(MaxNLocator(5))
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        axes.tick_params(labelsize=8)
        axes.set_xlabel("pixel, in ascending order of the target's height", fontsize=8)
        axes.set_ylabel(f"height ({profile.unit})", fontsize=8, labelpad=1)
        axes.legend(loc="upper left", fontsize=8)
        add_scale(axes, shown, "pixels of the result per cell", "neither")

    return Panel(title, draw)


def write_height_profile(
    out: Path, target: processing.NormalMap, transferred: processing.NormalMap, result: Result
) -> HeightProfileMetrics:
    """Integrate two maps, write their height profile as picture and table, return its figures.

    The maps have no scale, so the heights are in pixels.
    """
    profile = processing.height_profile(
        processing.integrate(target, discontinuity=False),
        processing.integrate(transferred, discontinuity=False),
    )
    picture, data = out / "height_profile.png", out / "height_profile.csv"
    write_overview(picture, "Height profile", profile_panels("result", profile), columns=3)
    write_profile_data(data, profile)
    result.outputs |= {"height_profile": picture, "height_profile_data": data}
    result.summary.append(
        f"heights       rms difference {figure(profile.rms, 3)} {profile.unit}, range "
        f"{figure(profile.target_range, 3)} (smoothed {figure(profile.smoothed_rms, 3)})"
    )
    return {
        "height_rms_px": profile.rms,
        "height_smoothed_rms_px": profile.smoothed_rms,
        "height_range_px": profile.target_range,
    }


def write_profile_data(path: Path, profile: processing.HeightProfile) -> None:
    """Write evenly spaced points of a profile as a table of pixel ranks and heights."""
    pick = profile.ranks()
    heights = ("target", "result", "smoothed")
    rows = np.column_stack([pick, *(getattr(profile, name)[pick] for name in heights)])
    header = ",".join(["pixel", *(f"{name}_{profile.unit}" for name in heights)])
    table = io.BytesIO()
    np.savetxt(table, rows, ["%d", *["%.7g"] * 3], delimiter=",", header=header, comments="")
    acquisition.write_durably(path, table.getbuffer())
