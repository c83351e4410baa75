"""The lights of a result: where they are, how sure that is, and how well the images fit them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

import acquisition
from rig.arrays import Float64
from sgp.report.folder import ResultFolder
from sgp.report.html import Html, details, tag

_LEGEND: Final = (
    "Lights as the camera sees them: overhead in the middle, the horizon at the rim. "
    "Rings are 30, 60 and 90 degrees from the optical axis."
)
_RADIUS: Final = 100
_RINGS_DEG: Final = (30, 60, 90)
_MOST_ROWS: Final = 400
_SD_MM: Final = "Standard deviation of the position, mm"
_SD_DEG: Final = "Standard deviation of the direction, deg"
_RESIDUAL: Final = "Distance of highlights from the calibration, px"
_OF_IMAGES: Final = {
    "light_errors_deg": "Angle between light and image, deg",
    "image_residuals": "Residual of the image, % of the signal",
    "light_gains": "Brightness of the image, relative",
}
_CHARTS: Final = (_SD_MM, _SD_DEG, _RESIDUAL, *_OF_IMAGES.values())


def lights_section(folder: ResultFolder, lights: acquisition.Lights) -> Html:
    """Return a drawing of the lights as the camera sees them, and a table of them."""
    columns = _columns(folder, lights)
    drawing = tag("figure", _drawing(lights, columns), tag("figcaption", _LEGEND), class_="lights")
    shown = (title for title in _CHARTS if title in columns)
    charts = (bar_chart(title, lights.ids, columns[title].tolist()) for title in shown)
    table = details(f"Table of {len(lights)} lights", _table(lights.ids, columns))
    numbers = tag("div", tag("div", charts, class_="charts"), table)
    return tag("div", drawing, numbers, class_="columns")


def _columns(folder: ResultFolder, lights: acquisition.Lights) -> dict[str, Float64]:
    """Return directions, positions, errors, and the figures of agreement that records have."""
    x, y, z = lights.unit_directions.T
    found = {
        "Elevation, deg": np.degrees(np.arcsin(np.clip(z, -1, 1))),
        "Azimuth, deg": np.degrees(np.arctan2(y, x)),
    }
    if lights.positions_mm is not None:
        found |= {f"{axis}, mm": lights.positions_mm[:, i] for i, axis in enumerate("XYZ")}
    errors = lights.errors
    if errors is not None and errors.covariances is not None:
        spread = np.sqrt(np.trace(errors.covariances, axis1=1, axis2=2))
        found |= {_SD_MM: spread} if lights.near else {_SD_DEG: np.degrees(spread)}
    if errors is not None and errors.residual_px is not None:
        found[_RESIDUAL] = errors.residual_px
    for record in folder.records.values():
        for name, title in _OF_IMAGES.items():
            values: Any = record.metrics.get(name)
            if isinstance(values, list) and len(values) == len(lights):
                factor = 100 if name == "image_residuals" else 1
                numbers = [np.nan if value is None else float(value) for value in values]
                found[title] = factor * np.array(numbers)
    return found


def _drawing(lights: acquisition.Lights, columns: Mapping[str, Float64]) -> Html:
    parts = [
        tag("circle", r=round(_RADIUS * float(np.sin(np.radians(ring))), 1), class_="ring")
        for ring in _RINGS_DEG
    ]
    named = len(lights) <= 60
    for number, (x, y, _) in enumerate(lights.unit_directions):
        across, down = round(_RADIUS * float(x), 1), round(-_RADIUS * float(y), 1)
        name = lights.ids[number]
        values = (f"{title} {_number(column[number])}" for title, column in columns.items())
        title = tag("title", f"{name}: {', '.join(values)}")
        parts.append(tag("circle", title, cx=across, cy=down, r=3))
        if named:
            # Names point away from the middle.
            length = max(float(np.hypot(x, y)), 1e-6)
            right = round(across + 9 * float(x) / length, 1)
            below = round(down - 9 * float(y) / length + 2.5, 1)
            parts.append(tag("text", _short(name), x=right, y=below, text_anchor="middle"))
    box = _RADIUS + 18
    view, label = f"{-box} {-box} {2 * box} {2 * box}", f"Directions of {len(lights)} lights"
    return tag("svg", parts, viewBox=view, role="img", aria_label=label)


def _table(ids: Sequence[str], columns: Mapping[str, Float64]) -> Html:
    head = tag("tr", tag("th", "Light", scope="col"), (tag("th", n, scope="col") for n in columns))
    rows = [
        tag(
            "tr",
            tag("th", ids[number], scope="row"),
            (tag("td", _number(column[number]), class_="number") for column in columns.values()),
        )
        for number in range(min(len(ids), _MOST_ROWS))
    ]
    return tag("table", tag("thead", head), tag("tbody", rows))


def _number(value: float) -> str:
    if not np.isfinite(value):
        return "unknown"
    return f"{value:.1f}" if abs(value) >= 10 else f"{value:.3g}"


def _short(name: str) -> str:
    return name if len(name) <= 8 else f"…{name[-6:]}"


# As wide as a phone: letters have about the size of the page's on all windows.
_WIDTH: Final = 360
_HEIGHT: Final = 140
_LEFT, _TOP, _BOTTOM = 44, 26, 20
_LETTER: Final = 7  # width of a letter of a label


def bar_chart(title: str, names: Sequence[str], values: Sequence[float]) -> Html:
    """Return bars from 0; values that are not finite have none. ``title`` states the unit."""
    known = [value for value in values if math.isfinite(value)]
    most = max([0.0, *known]) or 1.0
    step = grid_step(most)
    top = step * math.ceil(most / step - 1e-9)
    tall, wide = _HEIGHT - _TOP - _BOTTOM, (_WIDTH - _LEFT) / max(len(values), 1)

    def down(value: float) -> float:
        return round(_TOP + tall * (1 - value / top), 1)

    parts = [tag("text", title, x=0, y=13, class_="title")]
    for place in range(round(top / step) + 1):
        y = down(place * step)
        parts += [
            tag("line", x1=_LEFT, x2=_WIDTH, y1=y, y2=y, class_="grid"),
            tag("text", f"{place * step:.4g}", x=_LEFT - 5, y=y + 4, text_anchor="end"),
        ]
    labels = [_short(name) for name in names]
    longest = max(map(len, labels), default=0)
    every = max(1, math.ceil(_LETTER * (longest + 1) / wide))
    for place, (name, value) in enumerate(zip(names, values, strict=True)):
        x = _LEFT + place * wide
        if math.isfinite(value):
            y = down(max(value, 0.0))
            left, width, height = x + 0.15 * wide, 0.7 * wide, _TOP + tall - y
            box = {"x": round(left, 1), "y": y, "width": round(width, 1)}
            bar = tag("title", f"{name}: {value:.3g}")
            parts.append(tag("rect", bar, **box, height=round(height, 1)))
        if place % every == 0:
            middle = round(x + wide / 2, 1)
            parts.append(tag("text", labels[place], x=middle, y=_HEIGHT - 6, text_anchor="middle"))
    view, label = f"0 0 {_WIDTH} {_HEIGHT}", f"{title}, for {len(values)} lights"
    return tag("svg", parts, viewBox=view, class_="chart", role="img", aria_label=label)


def grid_step(most: float) -> float:
    """Return a round distance of grid lines, so that there are two to four below ``most``."""
    power = 10.0 ** math.floor(math.log10(most))
    return next(m * power for m in (0.25, 0.5, 1, 2.5, 5) if most / (m * power) <= 4)
