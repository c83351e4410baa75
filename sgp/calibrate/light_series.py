"""A series of calibrations: files in the order of time, table, chart and figures of their drift."""

from __future__ import annotations

import csv
import io
import itertools
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

import acquisition
import calibration
import rig
from calibration.comparison import FALSE_ALARM, LightDrift
from rig.arrays import Float64
from sgp.cli.exit import UsageError
from sgp.pictures import drift_panels, write_overview
from sgp.results import DriftLightMetrics, DriftMetrics, Result, claim_folder

_SHOWN = 12


def check_series(
    files: Sequence[Path], limit_deg: float | None, limit_percent: float | None, out: Path | None
) -> Result:
    """Compare three or more calibrations, and write chart, table and record into a folder.

    Raises
    ------
    UsageError
        If a file is given twice, or a limit is for intensities that were not measured.
    DataError
        If the calibrations cannot be compared.
    """
    for a, b in itertools.combinations(files, 2):
        if os.path.samefile(a, b):
            raise UsageError(f"{a} and {b} are the same file: give each calibration once")
    # Calibrations in different folders mostly have the same file name.
    plain = len({file.name for file in files}) == len(files)
    names = [file.name if plain else str(file) for file in files]
    read = [acquisition.read_lights(file) for file in files]
    order, dated = calibration.comparison.order_by_date(read, names)
    series, names = [read[n] for n in order], [names[n] for n in order]
    drift = calibration.comparison.light_drift(
        series, names, least_deg=limit_deg or 0.0, least_percent=limit_percent or 0.0
    )
    measured = np.isfinite(drift.strength_percent[:, 0])
    if limit_percent is not None and not measured.any():
        raise UsageError("--limit-percent: fewer than 3 of these files have measured intensities")
    times = [one.calibrated.time_utc if dated and one.calibrated else None for one in series]
    dates = [time.isoformat() if time else None for time in times]
    metrics = _metrics(drift, names, dates)
    result = Result(
        metrics=metrics,
        warnings=[*(notice for one in series for notice in one.warnings), *drift.warnings],
        inputs=[files[n] for n in order],
        ok=not (drift.moved or drift.beyond.any()),
    )
    way = "of their dates" if dated else "of the arguments, because dates are missing"
    lights = rig.pluralize(len(drift.ids), "light")
    result.summary = [f"{len(files)} calibrations of {lights}, in the order {way}"]
    result.summary += _rows(metrics, (drift.ratio > 1).sum(axis=1).tolist())
    if not measured.all():
        equal = rig.listed([names[n] for n in np.flatnonzero(~measured)], 3)
        result.summary.append(f"intensities are not compared: those of {equal} are all equal")
    share = 100 * FALSE_ALARM
    result.summary.append(
        f"stable: all values are within the limits, as in {100 - share:g} % of stable series"
        if result.ok
        else f"beyond a limit, as at most {share:g} % of stable series"
    )
    if out is not None:
        folder = claim_folder(out, "check.json")
        path = result.file("table", folder / "drift.csv")
        acquisition.write_durably(path, _table(drift, names, dates).encode())
        title = f"{len(files)} calibrations, {names[0]} to {names[-1]}"
        panels = drift_panels(drift, [date[:10] for date in dates if date] or names)
        write_overview(result.file("chart", folder / "drift.png"), title, panels, len(panels))
    return result


def _metrics(drift: LightDrift, names: Sequence[str], dates: Sequence[str | None]) -> DriftMetrics:
    def largest(values: Float64, n: int) -> float:
        return float(np.fmax.reduce(np.abs(values[:, n])))

    sizes = np.linalg.norm(drift.offsets_deg, axis=2)
    lights: list[DriftLightMetrics] = [
        {
            "id": drift.ids[n],
            "direction_deg": largest(sizes, n),
            "direction_ratio": largest(drift.direction_ratio, n),
            "strength_percent": largest(drift.strength_percent, n),
            "strength_ratio": largest(drift.strength_ratio, n),
            "beyond": bool(drift.beyond[n]),
        }
        for n in drift.worst_first
    ]
    return {
        "lights": len(drift.ids),
        "beyond": int(drift.beyond.sum()),
        "moved": drift.moved,
        "false_alarm": FALSE_ALARM,
        "common_limit_deg": drift.common_limit_deg,
        "calibrations": [
            {
                "name": name,
                "time_utc": date,
                "common_deg": float(turn),
                "common_ratio": float(ratio),
            }
            for name, date, turn, ratio in zip(
                names, dates, drift.common_deg, drift.common_ratio, strict=True
            )
        ],
        "drifts": lights,
    }


def _rows(metrics: DriftMetrics, counts: Sequence[int]) -> Iterator[str]:
    """Yield tables of at most 78 characters; what is beyond a limit has an asterisk."""
    yield f"    {'calibration':26}{'date':>12}{'all turned':>13}{'beyond limits':>15}"
    for one, count in zip(metrics["calibrations"], counts, strict=True):
        name = one["name"] if len(one["name"]) <= 25 else f"...{one['name'][-22:]}"
        mark = "*" if (one["common_ratio"] or 0) > 1 else " "
        turned = _cell(one["common_deg"], ".3f", " deg")
        date = (one["time_utc"] or "-")[:10]
        lights = rig.pluralize(count, "light")
        yield f"  {mark} {name:26}{date:>12}{turned:>13}{lights:>15}"
    yield f"    {'light':14}{'direction':>12}{'of limit':>10}{'strength':>12}{'of limit':>10}"
    for light in metrics["drifts"][:_SHOWN]:
        name = light["id"] if len(light["id"]) <= 13 else f"{light['id'][:10]}..."
        cells = _cell(light["direction_deg"], ".3f", " deg"), _cell(light["direction_ratio"], ".2f")
        more = _cell(light["strength_percent"], ".1f", " %"), _cell(light["strength_ratio"], ".2f")
        mark = "*" if light["beyond"] else " "
        yield f"  {mark} {name:14}{cells[0]:>12}{cells[1]:>10}{more[0]:>12}{more[1]:>10}"
    hidden = metrics["drifts"][_SHOWN:]
    if hidden:
        count = sum(light["beyond"] for light in hidden)
        yield f"    and {len(hidden)} more, {count} of them beyond a limit"


def _cell(value: float | None, form: str, unit: str = "") -> str:
    return "-" if value is None or np.isnan(value) else f"{value:{form}}{unit}"


def _table(drift: LightDrift, names: Sequence[str], dates: Sequence[str | None]) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    head = ("calibration", "time_utc", "light", "direction_deg", "direction_of_limit")
    table.writerow([*head, "strength_percent", "strength_of_limit"])
    sizes = np.linalg.norm(drift.offsets_deg, axis=2)
    columns = (sizes, drift.direction_ratio, drift.strength_percent, drift.strength_ratio)
    for k, (name, date) in enumerate(zip(names, dates, strict=True)):
        rows = {"all": [drift.common_deg[k], drift.common_ratio[k], np.nan, np.nan]}
        rows |= {light: [one[k, n] for one in columns] for n, light in enumerate(drift.ids)}
        for light, values in rows.items():
            cells = [f"{value:.6g}" if np.isfinite(value) else "" for value in values]
            table.writerow([name, date or "", light, *cells])
    return text.getvalue()
