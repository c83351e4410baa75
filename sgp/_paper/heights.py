"""The paper's height profiles: a result's heights along its target's, in ascending order."""

from __future__ import annotations

from collections.abc import Callable

from processing import HeightProfile, NormalMap, height_profile, integrate, transfer
from sgp._overview import Panel, profile_panel
from sgp._paper import figures as paper
from sgp._paper.sources import Sources, bowl
from sgp._paper.tables import Number, Table

Advance = Callable[[str], None]

# The stand-ins for the paper's two sources, and what their curves are called on disk.
_STAND_INS = {"scales (simulated)": "scales", "cloth (simulated)": "cloth"}
_BOWL_POINTS = 50_000


def height_profiles(
    sources: Sources, textures: dict[str, NormalMap], advance: Advance
) -> tuple[Table, dict[str, HeightProfile], list[Panel]]:
    """Put two details onto one target and read the surfaces' heights; returns curves by name."""
    where, target = (
        ("bowl (simulated)", bowl(_BOWL_POINTS))
        if sources.data is None
        else ("cat", sources.given("diligent/cat"))
    )
    ground = integrate(target)
    profiles: dict[str, HeightProfile] = {}
    panels: list[Panel] = []
    rows: dict[str, list[Number]] = {}
    for texture, name in _STAND_INS.items():
        advance(f"heights of {texture} on {where}")
        done = transfer(textures[texture], target)
        profile = height_profile(ground, integrate(done.normal_map))
        profiles[f"height_profile_{name}"] = profile
        panels.append(profile_panel(f"{texture} on {where}", profile))
        for row, value in {
            "rms of result less target": profile.rms,
            "rms of result's 5 x 5 mean less target": profile.smoothed_rms,
            "the target's highest less its lowest": profile.target_range,
        }.items():
            rows.setdefault(f"{row}, {profile.unit}", []).append(value)
    return (
        Table(
            "height_profile",
            "Height profile: a result's heights along its target's",
            tuple(f"{texture} on {where}" for texture in _STAND_INS),
            rows,
            paper.HEIGHT_PROFILES,
            {"plotted, no figure printed": (None,) * len(paper.HEIGHT_PROFILES)},
            "The paper plots the curves of Lizard and Textile, synthesised over targets that it "
            "does not name; here the detail is laid side by side (order 8, w=5). Each connected "
            "part of a surface is free in height and set to its target's mean. The .csv files "
            "hold the curves.",
        ),
        profiles,
        panels,
    )
