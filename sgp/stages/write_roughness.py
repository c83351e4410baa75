"""Parameters of areas, profiles and steps, as files, figures and lines."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

import acquisition
from processing.roughness import SOURCES, Conformity, Limit, Quantity, Scales
from rig.arrays import AnyArray
from sgp.pictures import Panel, signed_panel, write_overview
from sgp.results import LimitMetrics, MeasuredMetrics, QuantityMetrics, Result, rounded

# Areas that the picture shows, and parameters that the terminal lists of each kind.
_SHOWN = 6
_LISTED = ("Sa", "Sq", "Sz", "Ssk", "Sku", "Sdq", "Sdr", "Sal", "Str", "Sk", "Spk", "Svk")


@dataclass(frozen=True, eq=False)
class Measured:
    """An area, a profile or a step that was measured.

    Parameters
    ----------
    name, kind, place
        As in its figures.
    heights_mm
        Scale-limited heights of an area, or heights along a line.
    quantities
        The parameters.
    scales
        Form and filters; None for a step.
    pixel_mm
        Distance between neighbouring pixels at its mean height.
    """

    name: str
    kind: Literal["area", "profile", "step"]
    place: str
    heights_mm: AnyArray
    quantities: Mapping[str, Quantity]
    scales: Scales | None
    pixel_mm: float

    def metrics(self) -> MeasuredMetrics:
        """Return the figures."""
        found = MeasuredMetrics(
            name=self.name,
            kind=self.kind,
            place=self.place,
            pixels=int(np.count_nonzero(np.isfinite(self.heights_mm))),
            pixel_mm=self.pixel_mm,
            parameters=[_figures(one) for one in self.quantities.values()],
        )
        if self.scales is not None:
            found["form"] = self.scales.form
            found["s_mm"], found["l_mm"] = self.scales.s_mm or 0.0, self.scales.l_mm or 0.0
        return found

    def lines(self) -> list[str]:
        """Return the lines for the terminal."""
        scales = self.scales
        what = ""
        if scales is not None:
            long = f"L-filter {scales.l_mm:g} mm" if scales.l_mm else "no L-filter"
            what = f": form {scales.form}, S-filter {scales.s_mm:g} mm, {long}"
        listed = [
            one
            for one in self.quantities.values()
            if math.isfinite(one.value) and (self.kind != "area" or one.name in _LISTED)
        ]
        return [f"{self.kind} {self.name}{what}", *(f"  {text_of(one)}" for one in listed)]


def text_of(one: Quantity) -> str:
    """Return a parameter with its expanded uncertainty, rounded to two digits of it."""
    unit = one.unit and f" {one.unit}"
    if not math.isfinite(one.value):
        return f"{one.name:5} is not defined"
    value, expanded = rounded(one.value, one.sigma)
    if not expanded:
        return f"{one.name:5} {value}{unit}"
    text = f"{one.name:5} {value} +- {expanded}{unit} (k = 2)"
    return f"{text}, not assured: {'; '.join(one.doubts)}" if one.doubts else text


def write_roughness(
    result: Result,
    measured: Sequence[Measured],
    judged: Sequence[tuple[Limit, str, Quantity, Conformity]],
    out: Path,
) -> None:
    """Write the table, the heights and the picture."""
    rows = [_row(one, quantity) for one in measured for quantity in one.quantities.values()]
    _write_table(result, "parameters", out / "parameters.csv", rows)
    panels = list[Panel]()
    for number, one in enumerate(measured):
        if one.kind == "area":
            path = result.file(f"heights_{number}", out / f"heights_{number}.exr")
            acquisition.write_exr(path, np.ascontiguousarray(one.heights_mm, np.float32))
            if len(panels) < _SHOWN:
                panels.append(signed_panel(f"{one.name}: heights", 1000 * one.heights_mm, "um"))
        else:
            lines = [
                {"position_mm": f"{at * one.pixel_mm:.7g}", "height_mm": f"{height:.9g}"}
                for at, height in enumerate(one.heights_mm)
            ]
            _write_table(result, f"heights_{number}", out / f"heights_{number}.csv", lines)
            if len(panels) < _SHOWN:
                panels.append(_line_panel(one))
    path = result.file("picture", out / "roughness.png")
    write_overview(path, "Roughness", panels, columns=min(len(panels), 3))
    if judged:
        limits = [
            {
                "region": region,
                "parameter": limit.parameter,
                "least": "" if limit.least is None else f"{limit.least:g}",
                "most": "" if limit.most is None else f"{limit.most:g}",
                "value": f"{quantity.value:.6g}",
                "expanded_uncertainty": f"{2 * quantity.sigma:.3g}",
                "answer": answer,
            }
            for limit, region, quantity, answer in judged
        ]
        _write_table(result, "limits", out / "limits.csv", limits)


def limit_metrics(judged: Sequence[tuple[Limit, str, Quantity, Conformity]]) -> list[LimitMetrics]:
    """Return the figures of limits."""
    return [
        LimitMetrics(
            parameter=limit.parameter,
            region=region,
            least=limit.least,
            most=limit.most,
            answer=answer,
        )
        for limit, region, _, answer in judged
    ]


def _line_panel(one: Measured) -> Panel:
    from matplotlib.axes import Axes

    from sgp.pictures import set_plot_area

    def draw(axes: Axes) -> None:
        set_plot_area(axes)
        axes.plot(np.arange(len(one.heights_mm)) * one.pixel_mm, 1000 * one.heights_mm, lw=1)
        axes.set_xlabel("position (mm)", fontsize=8)
        axes.set_ylabel("height (um)", fontsize=8)
        axes.tick_params(labelsize=8)

    return Panel(f"{one.kind} {one.name}", draw)


def _figures(one: Quantity) -> QuantityMetrics:
    return QuantityMetrics(
        name=one.name,
        unit=one.unit,
        value=_finite(one.value),
        sigma=_finite(one.sigma),
        measured=_finite(one.measured),
        budget=dict(one.budget),
        doubts=list(one.doubts),
    )


def _row(measured: Measured, one: Quantity) -> dict[str, str]:
    figures = {
        "value": one.value,
        "standard_uncertainty": one.sigma,
        "expanded_uncertainty_k2": 2 * one.sigma,
        "measured": one.measured,
    } | {source.replace(" ", "_"): one.budget.get(source, math.nan) for source in SOURCES}
    texts = {name: "" if math.isnan(value) else f"{value:.6g}" for name, value in figures.items()}
    scales = measured.scales
    head = {
        "region": measured.name,
        "kind": measured.kind,
        "place_px": measured.place,
        # The budget has a column "form".
        "nominal_form": "" if scales is None else scales.form,
        "s_mm": "" if scales is None else f"{scales.s_mm:g}",
        "l_mm": "" if scales is None else f"{scales.l_mm:g}",
        "parameter": one.name,
        "unit": one.unit,
    }
    return head | texts | {"doubts": "; ".join(one.doubts)}


def _write_table(result: Result, name: str, path: Path, rows: Sequence[Mapping[str, str]]) -> None:
    text = io.StringIO()
    table = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    acquisition.write_durably(result.file(name, path), text.getvalue().encode("utf-8"))


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
