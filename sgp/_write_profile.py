"""Height profile of a result along its target, as the paper plots it."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

import acquisition
import processing
from sgp._metrics import HeightProfileMetrics
from sgp._overview import write_overview
from sgp._panels.profile import profile_panels
from sgp._result import Result


def write_height_profile(
    out: Path, target: processing.NormalMap, transferred: processing.NormalMap, result: Result
) -> HeightProfileMetrics:
    """Integrate two maps, write their height profile as picture and table, return its figures.

    The maps have no scale, so the heights are in pixels.
    """
    profile = processing.height_profile(
        processing.integrate(target), processing.integrate(transferred)
    )
    picture, data = out / "height_profile.png", out / "height_profile.csv"
    write_overview(picture, "Height profile", profile_panels("result", profile), columns=3)
    write_profile_data(data, profile)
    result.outputs |= {"height_profile": picture, "height_profile_data": data}
    result.summary.append(
        f"heights       rms difference {profile.rms:.3g} {profile.unit}, range "
        f"{profile.target_range:.3g} (smoothed {profile.smoothed_rms:.3g})"
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
