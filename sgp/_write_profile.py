"""The height profile of a result along its target, as the paper plots it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from processing import HeightProfile, NormalMap, height_profile, integrate
from sgp._overview import Panel, write_overview
from sgp._result import Result

# More points than this only make the picture slow.
_DRAWN = 4000


def write_height_profile(
    out: Path, target: NormalMap, transferred: NormalMap, result: Result
) -> None:
    """Integrate two maps, draw their height profile and add its figures."""
    profile = height_profile(integrate(target), integrate(transferred))
    path = out / "height_profile.png"
    write_overview(path, "Height profile", [_panel(profile)], columns=1)
    result.outputs["height_profile"] = path
    result.metrics |= {
        f"height_rms_{profile.unit}": profile.rms,
        f"height_smoothed_rms_{profile.unit}": profile.smoothed_rms,
        f"height_range_{profile.unit}": profile.target_range,
    }
    result.summary.append(
        f"heights       {profile.rms:.3g} {profile.unit} rms apart, of {profile.target_range:.3g} "
        f"(smoothed {profile.smoothed_rms:.3g})"
    )


def _panel(profile: HeightProfile) -> Panel:
    def draw(axes: Axes) -> None:
        count = len(profile.target)
        pick = np.unique(np.linspace(0, count - 1, min(count, _DRAWN)).astype(np.intp))
        axes.plot(pick, profile.result[pick], ",", color="tab:green", label="result")
        axes.plot(pick, profile.smoothed[pick], "-", color="tab:red", lw=0.5, label="5 x 5 mean")
        axes.plot(pick, profile.target[pick], "-", color="tab:blue", label="target, sorted")
        axes.set_xlabel("pixel")
        axes.set_ylabel(f"height ({profile.unit})")
        axes.legend(loc="upper left", fontsize=8)

    return Panel(f"rms {profile.rms:.3g} {profile.unit}", draw)
