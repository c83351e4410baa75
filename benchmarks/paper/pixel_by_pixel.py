"""Small sheets that grow pixel by pixel (Efros and Leung), in comparison with quilted ones."""

from __future__ import annotations

import math
import time

import processing
from benchmarks.paper.tables import Number, Table
from rig import Progress
from sgp.pictures import Panel, lit_panel

_EXEMPLAR_PX, _SHEET_PX = 96, 128
# The sides of neighbourhoods and of patches.
_SIDES: dict[processing.SynthesisMethod, int] = {"efros-leung": 11, "quilting": 24}
_COLUMNS = (
    "over the exemplar's mean angle",
    "slope distance",
    "spectrum distance",
    "repeat score",
    "CPU time, s",
)


def pixel_by_pixel(
    exemplars: dict[str, processing.NormalMap], advance: Progress
) -> tuple[Table, list[Panel]]:
    """Compare both methods on small sheets; return a table, and a picture of each sheet."""
    rows: dict[str, list[Number]] = {}
    panels: list[Panel] = []
    for done, (name, normals) in enumerate(exemplars.items()):
        advance(f"small sheets of {name}", done, len(exemplars))
        detail, part = processing.separate(normals).detail, slice(_EXEMPLAR_PX)
        exemplar = processing.NormalMap(detail.normals[part, part], detail.mask[part, part])
        panels.append(lit_panel(name, exemplar))
        for method, side in _SIDES.items():
            synthesizer = processing.synthesis.SYNTHESIZERS[method]
            synthesizer(exemplar, (8, 8), patch=min(side, 7))  # compiles
            began = time.process_time()
            sheet = synthesizer(exemplar, (_SHEET_PX, _SHEET_PX), patch=side).detail
            cpu_s = time.process_time() - began
            found = processing.synthesis.texture_figures(sheet, exemplar, patch=_SIDES["quilting"])
            figures = (found.slope_distance, found.spectrum_distance, found.repeat_score)
            rows[f"{name}, {method}"] = [
                found.detail_angle_deg / found.exemplar_angle_deg,
                *(None if math.isnan(value) else value for value in figures),
                cpu_s,
            ]
            panels.append(lit_panel(f"{name}: {method}", sheet))
    note = (
        f"Sheets of {_SHEET_PX} x {_SHEET_PX} pixels from {_EXEMPLAR_PX} x {_EXEMPLAR_PX}, "
        f"neighbourhoods of {_SIDES['efros-leung']} and patches of {_SIDES['quilting']} pixels. "
        "The time of Efros-Leung grows with the product of both areas."
    )
    return Table("efros_leung", "Pixel by pixel", _COLUMNS, rows, note), panels
