"""Roughness of the parts of a batch: their table, and a chart over the parts."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from sgp.batch.tables import csv_text
from sgp.pictures import Panel, Series, control_panel
from sgp.results import ResultRecord, read_record

ROUGHNESS: Final = "roughness"  # folder with one for each part
_COLUMNS: Final = (
    "part", "recorded_utc", "region", "kind", "parameter", "unit", "value",
    "expanded_uncertainty_k2", "least", "most", "answer", "doubts",
)  # fmt: skip
# Parameters with a chart if there are no limits.
_USUAL: Final = ("Sa", "Sz", "Ra", "Rz", "d")
_MOST_CHARTS: Final = 12


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a batch with the record of its roughness."""

    name: str
    record: ResultRecord

    @property
    def recorded(self) -> str:
        """Start of its recording, ISO 8601; empty if it is not known."""
        return next((one.started_utc for one in self.record.recordings if one.started_utc), "")

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield the parameters with values by the columns of the table, one for each limit."""
        figures: Any = self.record.metrics
        for region in figures["regions"]:
            for found in region["parameters"]:
                if found["value"] is None:
                    continue
                limits = [
                    one
                    for one in figures.get("limits", ())
                    if (one["region"], one["parameter"]) == (region["name"], found["name"])
                ]
                sigma = math.nan if found["sigma"] is None else found["sigma"]
                row = {
                    "part": self.name,
                    "recorded_utc": self.recorded,
                    "region": region["name"],
                    "kind": region["kind"],
                    "parameter": found["name"],
                    "unit": found["unit"],
                    "value": found["value"],
                    "expanded_uncertainty_k2": 2 * sigma,
                    "doubts": "; ".join(found["doubts"]),
                }
                for limit in limits or [{"least": None, "most": None, "answer": ""}]:
                    yield row | {name: limit[name] for name in ("least", "most", "answer")}

    def has(self, answer: str) -> bool:
        """Return whether a limit has this answer."""
        limits: Any = self.record.metrics.get("limits", ())
        return any(one["answer"] == answer for one in limits)


def read_parts(out: Path, names: Iterable[str]) -> list[Part]:
    """Return the parts in the order of their recordings; without all dates, as they are named.

    Raises
    ------
    DataError, MissingPathError
        If a record cannot be read.
    """
    parts = [Part(name, read_record(out / ROUGHNESS / name / "roughness.json")) for name in names]
    return sorted(parts, key=lambda one: one.recorded) if all(p.recorded for p in parts) else parts


def roughness_table(parts: Sequence[Part]) -> str:
    """Return the parameters of all parts as CSV; texts are safe in spreadsheets."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for part in parts:
        writer.writerows([_cell(row[name]) for name in _COLUMNS] for row in part.rows())
    return text.getvalue()


def _cell(value: object) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.6g}"
    return "" if value is None else csv_text(str(value))


def control_charts(parts: Sequence[Part]) -> list[Panel]:
    """Return individuals charts of the parameters with limits; without any, of the usual ones."""
    rows: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in (row for part in parts for row in part.rows()):
        rows.setdefault((row["region"], row["parameter"]), []).append(row)
    limited = {key: found for key, found in rows.items() if any(row["answer"] for row in found)}
    usual = {key: found for key, found in rows.items() if key[1] in _USUAL}
    chosen = list((limited or usual).values())[:_MOST_CHARTS]
    return [control_panel(_series(found)) for found in chosen]


def _series(rows: Sequence[Mapping[str, Any]]) -> Series:
    first = rows[0]
    unit = first["unit"] and f" ({first['unit']})"
    # A part with several limits has as many rows.
    last = {row["part"]: row for row in rows}
    exceeded = {row["part"] for row in rows if row["answer"] == "exceeded"}
    ends = {row[name] for row in rows for name in ("least", "most")} - {None}
    return Series(
        f"{first['region']}: {first['parameter']}{unit}",
        list(last),
        np.array([row["value"] for row in last.values()], np.float64),
        np.array([row["expanded_uncertainty_k2"] for row in last.values()], np.float64),
        np.array([name in exceeded for name in last]),
        sorted(ends),
    )
