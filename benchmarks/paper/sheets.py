"""Synthesised sheets in comparison with repeated and mirrored exemplars."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from functools import partial

import numpy as np

import processing
import rig
from benchmarks.paper import figures as paper
from benchmarks.paper.comparison import Comparison
from benchmarks.paper.exemplars import captured, materials, structured
from benchmarks.paper.measure import cost
from benchmarks.paper.pixel_by_pixel import pixel_by_pixel
from benchmarks.paper.sources import Sources
from benchmarks.paper.synthesis_peers import compare_systems, trained
from benchmarks.paper.tables import Number, Table
from rig import Progress
from sgp.pictures import Crop, Panel, lit_panel
from sgp.stages.write_profile import profile_panels

PATCH_PX = 48
_SIDE_PX, _QUICK_SIDE_PX = 2048, 1024
_SHOWN_PX = 512
# The second is the paper's number of vertices.
_SAME_MPX = 1.67
_SIZES_MPX = (1, _SAME_MPX, 5, 20)
_BOWL_POINTS = 50_000
_COLUMNS = (
    "mean angle, deg",
    "over the exemplar's",
    "slope distance",
    "spectrum distance",
    "repeat score",
    "step at borders over inside",
)
_TILES: dict[str, processing.Tile] = {"plain tiles": "plain", "mirrored tiles": "mirror"}

_PREFACE = (
    "# Synthesised sheets\n\n"
    "Sheets by image quilting, next to sheets on which the exemplar is repeated or mirrored, each "
    "compared with its exemplar. The exemplars are not those of the paper, and the computer is "
    "another one: read the paper's figures as context."
)


def run_sheets(*, quick: bool, seed: int, advance: Progress, side: int | None = None) -> Comparison:
    """Compute all tables of synthesis that the available data allow.

    Parameters
    ----------
    quick
        Smaller sheets, and only parts of reliefs as exemplars.
    seed
        Seed of the simulated materials.
    advance
        Called before each step: what it does, and how much of this table is done.
    side
        Side of the sheets in pixels; default: 2048, with `quick` 1024.
    """
    sources, comparison = Sources.found(), Comparison(_PREFACE)
    side = side or (_QUICK_SIDE_PX if quick else _SIDE_PX)
    simulated = materials(seed)
    given = dict(captured(sources, complete=not quick))
    materials_made = _quality("sheets", simulated | given, side, advance)
    comparison.add("sheets", "Materials, and sheets made from them", 4, *materials_made)
    structures_made = _quality("structured", structured(), side, advance)
    comparison.add("structured", "Ordered structures", 4, *structures_made)
    small = pixel_by_pixel(simulated | structured(), advance)
    comparison.add("efros_leung", "Efros-Leung and quilting", 3, *small)
    comparison.tables.append(_cost(simulated, [_SAME_MPX] if quick else _SIZES_MPX, advance))
    table, comparison.profiles, panels = _onto_target(sources, simulated, advance)
    title = "Heights, sorted by the target's (order 8)"
    comparison.add("height_profile", title, 4, table, panels)
    if trained():
        table, panels = compare_systems(sources, advance)
        comparison.add("synthesis_systems", "Synthesis by all systems", 6, table, panels)
    if sources.data is None:
        comparison.without_data("reliefs, owl, plant and cat are left out; all is simulated")
    if quick:
        comparison.shortened(f"sheets of {side} x {side} pixels, and no complete maps as exemplars")
    comparison.files = sorted(sources.files)
    return comparison


def _quality(
    key: str, exemplars: dict[str, processing.NormalMap], side: int, advance: Progress
) -> tuple[Table, list[Panel]]:
    rows: dict[str, list[Number]] = {}
    panels: list[Panel] = []
    flat = _flat(side)
    for done, (name, normals) in enumerate(exemplars.items()):
        advance(f"sheet of {name}", done, len(exemplars))
        exemplar = processing.separate(normals).detail
        made = processing.synthesize(exemplar, (side, side), patch=PATCH_PX)
        sheets = {"synthesised": (made.detail, made.steps.ratio)}
        for label, tile in _TILES.items():
            tiled = processing.transfer(normals, flat, tile=tile)
            sheets[label] = tiled.detail, tiled.seam.ratio
        panels.append(_panel(name, exemplar))
        for label, (sheet, steps) in sheets.items():
            found = processing.synthesis.texture_figures(sheet, exemplar, patch=PATCH_PX)
            if label == "synthesised":
                rows[f"{name}, exemplar"] = [
                    found.exemplar_angle_deg, None, None, *map(
                        _known, (found.exemplar_spectrum_distance, found.exemplar_repeat_score)
                    ), None,
                ]  # fmt: skip
            rows[f"{name}, {label}"] = [
                found.detail_angle_deg,
                found.detail_angle_deg / found.exemplar_angle_deg,
                found.slope_distance,
                _known(found.spectrum_distance),
                _known(found.repeat_score),
                _known(steps),
            ]
            panels.append(_panel(f"{name}: {label}", sheet))
    title = "Ordered structures" if key == "structured" else "Materials"
    note = (
        f"Sheets of {side} x {side} pixels, patches of {PATCH_PX}. Distances are 0 for sheets like "
        "the exemplar; the slopes' is relative to their spread, and the spectrum distance in the "
        "row of an exemplar is that of its halves. Repeat score: largest autocorrelation at lags "
        f"of at least {PATCH_PX} pixels, 1 for an exact repetition. Mirrored tiles repeat with "
        "twice the period. An ordered structure correlates with itself, so its exemplar has a high "
        "score, too."
    )
    return Table(key, f"{title}: sheets and their exemplars", _COLUMNS, rows, note), panels


def _cost(
    exemplars: dict[str, processing.NormalMap], sizes_mpx: Sequence[float], advance: Progress
) -> Table:
    """Measure sheets of several sizes, one with as many pixels as the paper's target."""
    name, normals = next(iter(exemplars.items()))
    exemplar = processing.separate(normals).detail
    rows: dict[str, list[Number]] = {}
    for done, size in enumerate(sizes_mpx):
        advance(f"cost of {size:g} million pixels", done, len(sizes_mpx))
        side = round(math.sqrt(size * 1e6))
        work = partial(processing.synthesize, exemplar, (side, side), patch=PATCH_PX)
        rows[f"{size:g} million pixels"] = cost(work)
    return Table(
        "cost",
        "Cost of sheets",
        ("CPU time, s", "elapsed time, s", "memory, MB"),
        rows,
        f"Here: {name}, 256 x 256 pixels, on {_computer()}; memory is the peak above that before. "
        "The paper's figures are for a target surface, on another computer and with another method "
        "of synthesis.",
        ("time, s", "memory, MB"),
        paper.SYNTHESIS,
    )


def _onto_target(
    sources: Sources, exemplars: dict[str, processing.NormalMap], advance: Progress
) -> tuple[Table, dict[str, processing.HeightProfile], list[Panel]]:
    """Put synthesised details on a target, and compare details and heights."""
    where, target = sources.target(_BOWL_POINTS)
    shape, ground = (
        processing.separate(target).shape,
        processing.integrate(target, discontinuity=False),
    )
    rows: dict[str, list[Number]] = {}
    profiles: dict[str, processing.HeightProfile] = {}
    panels: list[Panel] = []
    for done, (name, normals) in enumerate(exemplars.items()):
        advance(f"{name} on {where}", done, len(exemplars))
        exemplar = processing.separate(normals).detail
        meant = processing.synthesize_onto(exemplar, shape, patch=PATCH_PX).detail
        result = processing.combine(shape, meant)
        again = processing.detail.compare_details(processing.separate(result).detail, meant)
        profile = processing.height_profile(
            ground, processing.integrate(result, discontinuity=False)
        )
        profiles[f"height_profile_{name.replace(' ', '_')}"] = profile
        panels += [lit_panel(f"{name} on {where}", result), *profile_panels(name, profile)]
        for row, value in {
            "SSIM of the detail separated again, paper's protocol": again.ssim_paper,
            "SSIM of the detail separated again, mask only": again.ssim,
            "detail error, deg": again.mae_deg,
            f"rms of heights less target, {profile.unit}": profile.rms,
            f"the target's highest less its lowest, {profile.unit}": profile.target_range,
        }.items():
            rows.setdefault(row, []).append(value)
    note = (
        "Gaussian of order 8, w=5. The paper compares the same things on its own surfaces and "
        "plots the height profiles; the .csv files contain the curves."
    )
    table = Table(
        "onto_target",
        f"Synthesised detail on {where}, separated again",
        tuple(exemplars),
        rows,
        note,
    )
    return table, profiles, panels


def _flat(side: int) -> processing.NormalMap:
    normals = np.zeros((side, side, 3), np.float32)
    normals[..., 2] = 1
    return processing.NormalMap(normals, np.ones((side, side), np.bool_))


def _panel(title: str, detail: processing.NormalMap) -> Panel:
    """Show the first rows and columns of a detail component, which start at a border of tiles."""
    part = slice(_SHOWN_PX)
    shown = processing.NormalMap(detail.normals[part, part], detail.mask[part, part])
    height, width = shown.size
    return lit_panel(f"{title}, {width} x {height}", shown, Crop.around(shown.mask))


def _known(value: float) -> Number:
    return None if math.isnan(value) else value


def _computer() -> str:
    """Return the number of cores and their clock, as far as the system states them."""
    cores = rig.pluralize(os.cpu_count() or 1, "core")
    try:
        with open("/proc/cpuinfo", encoding="ascii", errors="replace") as file:
            clocks = [float(line.split(":")[1]) for line in file if line.startswith("cpu MHz")]
    except (OSError, ValueError, IndexError):
        clocks = []
    return f"{cores} at {max(clocks) / 1000:.1f} GHz" if clocks else cores
