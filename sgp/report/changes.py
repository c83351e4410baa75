"""The table of changes between two recordings, and the smallest that would have been found."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from itertools import islice
from typing import Any, Final

import rig
from sgp.report.folder import ResultFolder
from sgp.report.html import Html, tag
from sgp.report.source_maps import change_of

_MOST_ROWS: Final = 400


def changes_section(folder: ResultFolder) -> Sequence[Html]:
    """Return the significant changes of a registered comparison; nothing for other results."""
    record = change_of(folder)
    if record is None:
        return ()
    figures: Any = record.metrics
    count, levels, unit = figures.get("changes"), figures.get("levels"), figures.get("unit")
    if count is None or levels is None:
        return (tag("p", "Significance was not computed: compare again with --significance."),)
    heads = ["", "Column, row", f"x, y in {unit}", "Change of", f"Length x width, {unit}"]
    heads += [f"Area, {unit}²", f"Height (k = 2), {unit}", "Albedo factor (k = 2)", "Significance"]
    path = folder.path / "changes.csv"
    try:
        with path.open(encoding="ascii", newline="") as file:
            cells = [_cells(row, unit) for row in islice(csv.DictReader(file), _MOST_ROWS)]
    except (OSError, ValueError, KeyError, csv.Error):
        return (tag("p", f"{path} is missing or damaged: compare again."),)
    found = f"{rig.pluralize(count, 'significant change')}, AFTER - BEFORE. "
    found += "A loss has a negative height; x is to the right and y up from the middle of BEFORE. "
    found += "If nothing had changed, there would be one with a probability of at most "
    found += f"{figures['false_alarm']:.0%}."
    if count > len(cells):
        found += f" {count - len(cells)} more are in changes.csv."
    sizes = [f"Width, {unit}", f"Scratch, {unit}", f"Spot, {unit}"]
    limits = [
        (
            f"{level['width']:.3g}",
            *(_range(level[kind], level[f"{kind}_worst"]) for kind in ("scratch", "spot")),
        )
        for level in levels
    ]
    least = (
        "Smallest depths that would have been found with 95 %, at a usual place (at all but 5 % of "
        "the places). Smaller changes may exist."
    )
    return (
        tag("p", found, class_="lead"),
        _table(heads, cells) if cells else Html(""),
        tag("p", least, class_="lead"),
        _table(sizes, limits),
    )


def _cells(row: dict[str, str], unit: str) -> Sequence[str]:
    return (
        row["number"],
        f"{row['column_px']}, {row['row_px']}",
        f"{_text(row[f'x_{unit}'])}, {_text(row[f'y_{unit}'])}",
        row["kind"],
        f"{_text(row[f'length_{unit}'])} x {_text(row[f'width_{unit}'])}",
        _text(row[f"area_{unit}2"]),
        _with_error(row[f"height_{unit}"], row[f"height_sigma_{unit}"]),
        _with_error(row["albedo_factor"], row["albedo_sigma"]),
        f"{_text(row['significance'])} sigma",
    )


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> Html:
    head = tag("tr", (tag("th", one, scope="col") for one in heads))
    body = (tag("tr", (tag("td", cell) for cell in row)) for row in rows)
    table = tag("table", tag("thead", head), tag("tbody", body), class_="changes")
    return tag("div", table, class_="scroll")


def _text(value: str) -> str:
    return f"{float(value):.3g}" if value else ""


def _with_error(value: str, sigma: str) -> str:
    return f"{float(value):.3g} ± {2 * float(sigma):.2g}" if value and sigma else ""


def _range(usual: float | None, worst: float | None) -> str:
    first, second = ("none" if one is None else f"{one:.2g}" for one in (usual, worst))
    return f"{first} ({second})"
