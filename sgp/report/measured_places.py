"""Pictures of areas, profiles and steps: where they are, and their heights."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

import acquisition
from rig import figure
from rig.arrays import AnyArray, Bool, Float32, Floating
from sgp.pictures import Crop
from sgp.report.html import Html, tag
from sgp.report.large_maps import Values, known, read_map
from sgp.report.lights import grid_step
from sgp.report.prerendered import coded_jpeg

_SIDE_PX: Final = 640
_QUALITY: Final = 88
_TAIL: Final = 0.01  # share of the pixels beyond the colour scale
_LIGHT: Final = (-0.5, 0.5, 0.7071)
_STEPS: Final = 24  # of a colour scale


def places_figure(heights: Values, measured: Sequence[Any], pixel_mm: float) -> Html:
    """Return the surface under a light from the upper left, with the places of measurements."""
    inside = known(heights)
    crop = replace(Crop.around(inside), most_px=_SIDE_PX)
    picture = _shade(crop.picture(heights, inside), crop.step * pixel_mm)
    size = max(crop.size)
    marks = [mark for one in measured for mark in _mark(one, size)]
    label = f"Places of {', '.join(one['name'] for one in measured)}"
    return tag("figure", _svg(picture, crop, marks, label), tag("figcaption", "Measured places"))


def area_figure(
    file: Path, heights: Values | None, one: Any, pixel_mm: float, max_pixels: int
) -> Html:
    """Return the scale-limited heights of an area in colours, with its surroundings in grey.

    Raises
    ------
    DataError, MissingPathError
        If the file cannot be read.
    """
    limited = read_map(file, max_pixels)
    x, y, width, height = map(int, one["place"].split(","))
    margin = max(width, height) // 6 + 2
    rows = slice(max(y - margin, 0), min(y + height + margin, limited.shape[0]))
    columns = slice(max(x - margin, 0), min(x + width + margin, limited.shape[1]))
    crop = Crop(rows, columns, most_px=_SIDE_PX)
    shown = 1000 * crop.picture(limited)
    inside = np.isfinite(shown)
    if not inside.any():
        raise acquisition.DataError(f"{file}: has no heights")
    most = float(np.quantile(np.abs(shown[inside]), 1 - _TAIL)) or 1.0
    around = np.full(shown.shape, np.nan, np.float32)
    if heights is not None and heights.shape == limited.shape:
        around = crop.picture(heights)
    picture = _coloured(shown, inside, most, _shade(around, crop.step * pixel_mm))
    label = f"Scale-limited heights of {one['name']}"
    drawing = _svg(picture, crop, _mark({**one, "name": ""}, max(crop.size)), label)
    size = f"{figure(width * pixel_mm, 3)} x {figure(height * pixel_mm, 3)} mm"
    caption = f"{label}, {size}; the colours leave out {_TAIL:.0%} of the pixels"
    return tag("figure", drawing, _colour_scale(most), tag("figcaption", caption))


def line_figure(file: Path, name: str) -> Html:
    """Return the heights along a line as a chart.

    Raises
    ------
    DataError
        If the file is missing or damaged.
    """
    try:
        with file.open(encoding="utf-8", newline="") as table:
            found = [
                (float(row["position_mm"]), 1000 * float(row["height_mm"]))
                for row in csv.DictReader(table)
            ]
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
        raise acquisition.DataError(f"{file}: is missing or damaged: measure again") from error
    x, y = np.array(found or [(0.0, 0.0)]).T
    caption = tag("figcaption", f"Heights along {name}, in µm over mm")
    return tag("figure", _chart(x, y, f"Heights along {name}"), caption)


def _shade(heights: Float32, pixel_mm: float) -> Floating:
    """Return heights in mm under a light from the upper left, RGB; unknown ones are white."""
    down, right = np.gradient(heights / np.float32(pixel_mm))
    normals = np.stack([-right, down, np.ones_like(heights)], axis=-1)
    lit = normals @ np.array(_LIGHT) / np.linalg.norm(normals, axis=-1)
    gray = np.where(np.isfinite(lit), 0.1 + 0.9 * np.clip(lit, 0, 1), 1.0)
    return np.repeat(gray[..., None], 3, axis=2)


def _coloured(values: Float32, inside: Bool, most: float, around: Floating) -> Floating:
    colours = _colours(np.clip(np.nan_to_num(values) / most / 2 + 0.5, 0, 1))
    return np.where(inside[..., None], colours, around)


def _colours(shares: AnyArray) -> Floating:
    from matplotlib import colormaps  # slow to import

    return np.asarray(colormaps["coolwarm"](shares)[..., :3])


def _svg(picture: Floating, crop: Crop, marks: Sequence[Html], label: str) -> Html:
    """Return a picture with marks, whose coordinates are columns and rows of the map."""
    left, right, bottom, top = crop.extent
    box = {"x": left, "y": top, "width": right - left, "height": bottom - top}
    image = tag("image", **box, href=coded_jpeg(picture, _QUALITY), preserveAspectRatio="none")
    view = f"{left} {top} {right - left} {bottom - top}"
    drawn = [image, *marks]
    return tag("svg", drawn, viewBox=view, class_="places", role="img", aria_label=label)


def _mark(one: Any, size: float) -> list[Html]:
    """Return outline and name of a place in a picture of some size."""
    x, y, across, down = map(float, one["place"].split(",")[:4])
    if one["kind"] == "area":
        box = {"x": x - 0.5, "y": y - 0.5, "width": across, "height": down}
        parts = [tag("rect", **box, class_=kind) for kind in ("halo", "outline")]
    else:
        ends = {"x1": x, "y1": y, "x2": across, "y2": down}
        parts = [tag("line", **ends, class_=kind) for kind in ("halo", "outline")]
    if one["name"]:
        letters = round(size / 26, 1)
        around = {"stroke_width": letters / 6}
        parts.append(tag("text", one["name"], x=x, y=y - letters / 3, font_size=letters, **around))
    return parts


def _colour_scale(most: float) -> Html:
    colours = np.rint(255 * _colours((np.arange(_STEPS) + 0.5) / _STEPS)).astype(int)
    width = 240 / _STEPS
    parts = [
        tag("rect", x=40 + n * width, y=2, width=width + 0.3, height=10, fill=f"rgb({r},{g},{b})")
        for n, (r, g, b) in enumerate(colours.tolist())
    ]
    for x, text in ((40, f"-{figure(most, 3)}"), (160, "0"), (280, f"{figure(most, 3)} µm")):
        parts.append(tag("text", text, x=x, y=24, text_anchor="middle"))
    label = f"Colours from -{figure(most, 3)} to {figure(most, 3)} µm"
    return tag("svg", parts, viewBox="0 0 320 28", class_="colours", role="img", aria_label=label)


def _chart(x: Floating, y: Floating, label: str) -> Html:
    """Return a chart of a line."""
    wide, tall, left, top, below = 640, 180, 60, 8, 24
    low, high = float(np.nanmin(y)), float(np.nanmax(y))
    step = grid_step(high - low or 1.0)
    first, last = math.floor(low / step), math.ceil(high / step)
    last = max(last, first + 1)
    end = float(x[-1]) or 1.0
    right = wide - left - 12

    def across(value: float) -> float:
        return round(left + right * value / end, 1)

    def down(value: float) -> float:
        share = (value / step - first) / (last - first)
        return round(top + (tall - top - below) * (1 - share), 1)

    parts = []
    for place in range(first, last + 1):
        height = down(place * step)
        parts += [
            tag("line", x1=left, x2=left + right, y1=height, y2=height, class_="grid"),
            tag("text", f"{place * step:.6g}", x=left - 6, y=height + 4, text_anchor="end"),
        ]
    unit = grid_step(end)
    for place in range(int(end / unit + 1e-9) + 1):
        at = across(place * unit)
        parts += [
            tag("line", x1=at, x2=at, y1=top, y2=tall - below, class_="grid"),
            tag("text", f"{place * unit:.4g}", x=at, y=tall - 8, text_anchor="middle"),
        ]
    points = " ".join(f"{across(a)},{down(b)}" for a, b in zip(x, y, strict=True))
    parts.append(tag("polyline", points=points, class_="line"))
    view = f"0 0 {wide} {tall}"
    return tag("svg", parts, viewBox=view, class_="profile", role="img", aria_label=label)
