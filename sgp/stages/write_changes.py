"""Differences and significant changes of two registered fields, as files and lines."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

import numpy as np

import acquisition
import processing
import rig
from processing.changes import Change, Changes
from processing.registration import Field, Registration
from rig.arrays import Float32
from sgp.pictures import Crop, Panel, map_panel, normals_panel, signed_panel, write_overview
from sgp.results import LevelMetrics, RegisteredMetrics, Result

# For the heading of a table without changes.
_NONE = Change(0, 0, "surface", *[math.nan] * 9)
# Changes that the terminal lists.
_LISTED = 10


def add_difference(
    result: Result,
    before: Field,
    after: Field,
    registration: Registration,
    pixel_mm: float | None,
    out: Path | None,
) -> RegisteredMetrics:
    """Add what differs between a field and another one on its pixels; return the figures."""
    angle_deg = np.where(
        registration.common,
        acquisition.angle_deg(before.normal_map.normals, after.normal_map.normals),
        np.nan,
    ).astype(np.float32)
    rows, columns = np.nonzero(registration.common)
    middle = np.array([columns.mean()]), np.array([rows.mean()])
    there = registration.at(*middle)
    metrics = RegisteredMetrics(
        shift_px=(float(there[0][0] - middle[0][0]), float(there[1][0] - middle[1][0])),
        turn_deg=registration.turn_deg,
        tilt_deg=math.degrees(math.acos(min(float(registration.rotation[2, 2]), 1.0))),
        registration_sigma_px=registration.sigma_px,
        correlation=registration.correlation,
        common=len(rows) / np.count_nonzero(before.mask),
        median_deg=float(np.nanmedian(angle_deg)),
        unit="px" if pixel_mm is None else "mm",
        pixel_size=pixel_mm or 1.0,
    )
    result.summary += [
        f"registration  shift {metrics['shift_px'][0]:.2f} px right, {metrics['shift_px'][1]:.2f} "
        f"px down, turn {metrics['turn_deg']:.3f} deg, tilt {metrics['tilt_deg']:.3f} deg, "
        f"+- {metrics['registration_sigma_px']:.3f} px",
        f"in common     {metrics['common']:.1%} of the pixels of BEFORE",
        f"normals       median angle {metrics['median_deg']:.3f} deg",
    ]
    if out is not None:
        result.outputs |= processing.write_normals(out, after.normal_map)
        _write_map(result, out, "normals_deg", angle_deg)
        if before.albedo is not None and after.albedo is not None:
            with np.errstate(invalid="ignore", divide="ignore"):
                factor = np.where(registration.common, after.albedo / before.albedo, np.nan)
            _write_map(result, out, "albedo_factor", factor.astype(np.float32))
        panels = [
            normals_panel("before", before.normal_map),
            normals_panel("after, registered", after.normal_map),
            map_panel("angle between normals", angle_deg, "deg", error=True),
        ]
        path = result.file("picture", out / "difference.png")
        write_overview(path, "Difference, registered", panels)
    return metrics


def add_changes(
    result: Result, metrics: RegisteredMetrics, found: Changes, pixel_mm: float | None, out: Path
) -> None:
    """Add significant changes, the levels of detection, and their files."""
    size, unit = (1.0, "px") if pixel_mm is None else (pixel_mm, "mm")
    levels = [
        LevelMetrics(
            width=size * one.width_px,
            scratch=_finite(size * one.scratch),
            scratch_worst=_finite(size * one.scratch_worst),
            spot=_finite(size * one.spot),
            spot_worst=_finite(size * one.spot_worst),
        )
        for one in found.levels
    ]
    metrics["changes"] = len(found.changes)
    metrics["false_alarm"], metrics["threshold"] = found.false_alarm, found.threshold
    metrics["levels"] = levels
    rows = [
        _row(one, number, found.z.shape, size, unit) for number, one in enumerate(found.changes)
    ]
    text = io.StringIO()
    table = csv.DictWriter(text, _row(_NONE, 0, (1, 1), size, unit), lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    acquisition.write_durably(
        result.file("changes", out / "changes.csv"), text.getvalue().encode("ascii")
    )
    weight = np.where(found.difference.known, found.difference.weight, np.nan)
    left_deg = np.degrees(np.hypot(*found.difference.slopes))
    for name, values in (
        ("change_slope_deg", np.where(found.difference.known, left_deg, np.nan)),
        ("change_slope_sigma_deg", np.degrees(np.sqrt(2 / weight))),
        ("change_height", size * found.height),
        ("change_height_sigma", size * found.height_sigma),
        ("change_significance", found.z),
    ):
        _write_map(result, out, name, np.asarray(values, np.float32))
    if found.albedo_z is not None and found.difference.log_albedo is not None:
        _write_map(result, out, "change_log_albedo", found.difference.log_albedo)
        known = np.asarray(found.difference.albedo_weight)
        sigma = np.sqrt(1 / np.where(known > 0, known, np.nan))
        _write_map(result, out, "change_log_albedo_sigma", np.asarray(sigma, np.float32))
        _write_map(result, out, "albedo_significance", found.albedo_z)
    acquisition.write_mask(result.file("significant", out / "significant.png"), found.significant)
    write_overview(
        result.file("changes_picture", out / "changes.png"),
        f"{rig.pluralize(len(found.changes), 'significant change')}, AFTER - BEFORE",
        _panels(found, size, unit),
    )
    result.summary += _lines(found, levels, size, unit)


def _panels(found: Changes, size: float, unit: str) -> list[Panel]:
    scale, name = (1000 * size, "um") if unit == "mm" else (size, "px")
    changed = np.where(found.height == 0, np.float32(np.nan), scale * found.height)
    panels = [
        signed_panel(
            "change of height where significant", changed, name, Crop.around(found.difference.known)
        ),
        signed_panel("significance of changes of the surface", found.z, "sigma"),
    ]
    if found.albedo_z is not None:
        panels.append(
            signed_panel("significance of changes of the albedo", found.albedo_z, "sigma")
        )
    return panels


def _row(
    one: Change, number: int, shape: tuple[int, ...], size: float, unit: str
) -> dict[str, str]:
    """Return the columns of a change."""
    height, width = shape
    figures = {
        f"x_{unit}": (one.column - (width - 1) / 2) * size,
        f"y_{unit}": ((height - 1) / 2 - one.row) * size,
        f"length_{unit}": one.length_px * size,
        f"width_{unit}": one.width_px * size,
        f"width_sigma_{unit}": one.width_sigma_px * size,
        f"area_{unit}2": one.area_px * size**2,
        f"height_{unit}": one.height_px * size,
        f"height_sigma_{unit}": one.height_sigma_px * size,
        "albedo_factor": one.albedo_factor,
        "albedo_sigma": one.albedo_sigma,
        "significance": one.z,
    }
    texts = {name: "" if math.isnan(value) else f"{value:.5g}" for name, value in figures.items()}
    place = {"column_px": str(one.column), "row_px": str(one.row)}
    return {"number": str(number + 1), "kind": one.kind} | place | texts


def _lines(found: Changes, levels: list[LevelMetrics], size: float, unit: str) -> list[str]:
    count = len(found.changes)
    lines = [
        f"changes       {count or 'none'} significant; a map without a change has one with a "
        f"probability of {found.false_alarm:.0%} at most"
    ]
    for number, one in enumerate(found.changes[:_LISTED], 1):
        if one.kind == "surface":
            deviation = 2 * size * one.height_sigma_px
            height = rig.figure(size * one.height_px, 3)
            what = f"height {height} +- {rig.figure(deviation)} {unit} (k = 2)"
        else:
            what = f"albedo times {one.albedo_factor:.3f} +- {2 * one.albedo_sigma:.3f} (k = 2)"
        lines.append(
            f"  {number}: column {one.column}, row {one.row}, {rig.figure(size * one.length_px)} x "
            f"{rig.figure(size * one.width_px)} {unit}, {what}, {abs(one.z):.1f} sigma"
        )
    if count > _LISTED:
        lines.append(f"  and {count - _LISTED} more in changes.csv")
    lines += [
        f"detection     {rig.figure(level['width'], 3)} {unit} wide: scratches deeper than "
        f"{_depth(level['scratch'])}, spots deeper than {_depth(level['spot'])} {unit} would have "
        "been found with 95 %"
        for level in levels
    ]
    return lines


def _depth(value: float | None) -> str:
    return "any" if value is None else f"{rig.figure(value)}"


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _write_map(result: Result, out: Path, name: str, values: Float32) -> None:
    acquisition.write_exr(result.file(name, out / f"{name}.exr"), np.ascontiguousarray(values))
