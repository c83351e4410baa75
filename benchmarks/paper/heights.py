"""The paper's height profiles: heights of a result, sorted by the heights of its target."""

from __future__ import annotations

import processing
from benchmarks.paper import figures as paper
from benchmarks.paper.sources import Sources
from benchmarks.paper.tables import Number, Table
from rig import Progress
from sgp.pictures import Panel
from sgp.stages.write_profile import profile_panels

# The substitutes for the paper's two sources, and the file names of their curves.
_STAND_INS = {"scales (simulated)": "scales", "cloth (simulated)": "cloth"}
_BOWL_POINTS = 50_000


def height_profiles(
    sources: Sources, textures: dict[str, processing.NormalMap], advance: Progress
) -> tuple[Table, dict[str, processing.HeightProfile], list[Panel]]:
    """Transfer two details to one target and compare the heights; also returns curves by name."""
    where, target = sources.target(_BOWL_POINTS)
    ground = processing.integrate(target, discontinuity=False)
    profiles: dict[str, processing.HeightProfile] = {}
    panels: list[Panel] = []
    rows: dict[str, list[Number]] = {}
    for at, (texture, name) in enumerate(_STAND_INS.items()):
        advance(f"heights of {texture} on {where}", at, len(_STAND_INS))
        done = processing.transfer(textures[texture], target, tile="plain")
        profile = processing.height_profile(
            ground, processing.integrate(done.normal_map, discontinuity=False)
        )
        profiles[f"height_profile_{name}"] = profile
        panels += profile_panels(f"{texture} on {where}", profile)
        for row, value in {
            "rms of result less target": profile.rms,
            "rms of result's 5 x 5 mean less target": profile.smoothed_rms,
            "the target's highest less its lowest": profile.target_range,
        }.items():
            rows.setdefault(f"{row}, {profile.unit}", []).append(value)
    return (
        Table(
            "height_profile",
            "Height profile: heights of a result, sorted by the heights of its target",
            tuple(f"{texture} on {where}" for texture in _STAND_INS),
            rows,
            "The paper plots the curves of Lizard and Textile, synthesised over targets that it "
            "does not name. Here the detail is tiled (order 8, w=5). The height of each connected "
            "part of a surface is undetermined and is set to the mean of its target. The .csv "
            "files contain the curves.",
            paper.HEIGHT_PROFILES,
            {"plotted, no figure printed": (None,) * len(paper.HEIGHT_PROFILES)},
        ),
        profiles,
        panels,
    )
