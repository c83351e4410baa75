"""The certificate of a measurement of roughness: parameters, uncertainties, and how they arose."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import rig
from processing.roughness import PARAMETERS
from sgp.report.folder import Inputs, ResultFolder, noted
from sgp.report.html import Html, details, tag
from sgp.report.instrument import instrument_rows
from sgp.report.large_maps import Values, read_map
from sgp.report.measured_places import area_figure, line_figure, places_figure
from sgp.report.recording import Recording
from sgp.results import ResultRecord, rounded, verify_results

_LEAD: Final = (
    "U is the expanded uncertainty with the coverage factor k = 2, about 95 %. Values do not "
    "contain what noise adds. Areas follow ISO 25178-2, profiles ISO 21920-2, steps ISO 5436-1."
)
_VOID: Final = (
    "NOT VALID: files of the measurement, or what it was computed from, have changed; see the "
    "notices."
)
_BUDGET: Final = "Uncertainty budget: standard uncertainty by source, in the unit of the parameter"
# Columns of texts.
_TEXTS: Final = ("Parameter", "", "Unit", "Place", "Answer")
_noted = partial(noted, kind="map", severity="error")


def certificate(
    folder: ResultFolder,
    recording: Recording,
    max_pixels: int,
    notices: list[rig.Notice],
    check: Path | None = None,
) -> Sequence[Html]:
    """Return the certificate of a measurement of roughness; nothing for other results.

    What cannot be read, or has changed since, is left out and noted. ``check`` is the folder of a
    comparison of calibrations.
    """
    record = folder.roughness
    if record is None:
        return ()
    figures: Any = record.metrics
    pixel = figures["pixel_mm"]
    verified = verify_results([folder.path / "roughness.json"])
    notices += verified.notices
    by = f"{record.software.name} {record.software.version}, {record.command}. {_LEAD}"
    heights = _heights(folder, max_pixels, notices)
    regions = []
    for number, one in enumerate(figures["regions"]):
        drawn: list[Html] = []
        file = folder.path / record.outputs.get(f"heights_{number}", "")
        with _noted(notices):
            if one["kind"] == "area":
                scale = one.get("pixel_mm", pixel)
                drawn.append(area_figure(file, heights, one, scale, max_pixels))
            else:
                drawn.append(line_figure(file, one["name"]))
        regions.append(_region(one, drawn))
    where = () if heights is None else places_figure(heights, figures["regions"], pixel)
    about = (
        tag("h3", "Instrument"),
        _rows(instrument_rows(folder, recording, notices, check)),
        tag("h3", "Conditions"),
        _rows(_conditions(figures)),
    )
    return (
        tag("p", _VOID, class_="failed") if verified.faults else Html(""),
        tag("p", by, class_="lead"),
        tag("div", tag("div", *about), where, class_="columns"),
        *_limits(figures),
        *regions,
        details("Files of the result, and inputs (SHA-256)", _hashes(record)),
    )


def _heights(folder: ResultFolder, max_pixels: int, notices: list[rig.Notice]) -> Values | None:
    """Return the heights that were measured; None if they are gone or have changed."""
    inputs = Inputs(folder)
    names = folder.roughness.inputs if folder.roughness else ()
    for path in (folder.located(name) for name in names):
        if path.name == "height.exr" and inputs.state(path) == "same":
            with _noted(notices):
                return read_map(path, max_pixels)
    return None


def _conditions(figures: Any) -> Iterator[tuple[str, str]]:
    yield "Size of a pixel", f"{figures['pixel_mm']:.4g} mm at the mean height"
    lateral = rig.figure(figures["lateral_resolution_mm"], 3)
    yield "Lateral resolution", f"{lateral} mm: half of the amplitude remains"
    yield "Blur of the lens", f"{figures['lens_blur_px']:.2g} pixels (standard deviation)"
    for one in figures["regions"]:
        yield one["name"], _scales(one)


def _scales(one: Any) -> str:
    place = {"area": "x, y, width, height", "profile": "line", "step": "line"}[one["kind"]]
    where = f"{one['kind']}, {place} {', '.join(one['place'].split(','))} px"
    if "form" not in one:
        return where
    long = f"L-filter {one['l_mm']:g} mm" if one["l_mm"] else "no L-filter"
    return f"{where}: form {one['form']}, S-filter {one['s_mm']:g} mm, {long}"


def _region(one: Any, drawn: Sequence[Html]) -> Html:
    """Return the parameters of a place next to its picture, and their budget below."""
    defined = [found for found in one["parameters"] if found["value"] is not None]
    sources = list(dict.fromkeys(name for found in defined for name in found["budget"]))
    values = _table(
        ("Parameter", "", "Value", "U (k = 2)", "Unit"), (_value(found) for found in defined)
    )
    budget = _table(
        ("Parameter", "Unit", *(source.capitalize() for source in sources), "Combined"),
        (
            (
                tag("th", found["name"], scope="row"),
                _unit(found),
                *(_number(found["budget"].get(source)) for source in sources),
                _number(found["sigma"]),
            )
            for found in defined
        ),
    )
    absent = [found["name"] for found in one["parameters"] if found["value"] is None]
    missing = tag("p", f"Not defined here: {', '.join(absent)}.") if absent else ()
    wide = "columns" if one["kind"] == "area" else "stacked"
    return tag(
        "div",
        tag("h3", f"{one['kind'].capitalize()} {one['name']}"),
        tag("div", tag("div", values, missing, class_="scroll"), drawn, class_=wide),
        details(_BUDGET, budget) if sources else (),
        class_="measured",
    )


def _value(found: Any) -> Iterator[Html]:
    value, expanded = rounded(found["value"], found["sigma"])
    known = PARAMETERS.get(found["name"])
    meaning = "" if known is None else known.meaning.replace(" um ", " µm ")
    doubts = "; ".join(found["doubts"])
    doubt = tag("span", f"not assured: {doubts}", class_="doubt") if doubts else ()
    yield tag("th", found["name"], scope="row")
    yield tag("td", meaning, tag("br") if doubt else (), doubt)
    yield tag("td", value, class_="number")
    yield tag("td", expanded or "not known", class_="number")
    yield _unit(found)


def _limits(figures: Any) -> Iterator[Html]:
    if "limits" not in figures:
        return
    found = {
        (one["name"], parameter["name"]): parameter
        for one in figures["regions"]
        for parameter in one["parameters"]
    }
    yield tag("h3", "Limits (ISO 14253-1)")
    table = _table(
        ("Place", "Parameter", "At least", "At most", "Value", "U (k = 2)", "Unit", "Answer"),
        (_limit(one, found[one["region"], one["parameter"]]) for one in figures["limits"]),
    )
    yield tag("div", table, class_="scroll")


def _limit(limit: Any, found: Any) -> Iterator[Html]:
    value, expanded = (
        ("", "") if found["value"] is None else rounded(found["value"], found["sigma"])
    )
    ends = ("" if limit[end] is None else f"{limit[end]:g}" for end in ("least", "most"))
    yield tag("td", limit["region"])
    yield tag("th", limit["parameter"], scope="row")
    for text in (*ends, value, expanded):
        yield tag("td", text, class_="number")
    yield _unit(found)
    yield tag("td", limit["answer"], class_=f"answer {limit['answer']}")


def _hashes(record: ResultRecord) -> Html:
    files = {name: one.sha256 for name, one in record.files.items()} | record.inputs
    if record.record_sha256 is not None:
        files["roughness.json (record_sha256)"] = record.record_sha256
    return _rows((name, tag("code", digest)) for name, digest in files.items())


def _rows(rows: Iterable[tuple[str, str]]) -> Html:
    body = (tag("tr", tag("th", term, scope="row"), tag("td", text)) for term, text in rows)
    return tag("table", tag("tbody", body), class_="facts")


def _table(heads: Sequence[str], rows: Iterable[Iterable[Html]]) -> Html:
    cells = (
        tag("th", one, scope="col", class_=None if one in _TEXTS else "number") for one in heads
    )
    head = tag("tr", cells)
    return tag("table", tag("thead", head), tag("tbody", (tag("tr", row) for row in rows)))


def _unit(found: Any) -> Html:
    return tag("td", found["unit"].replace("um", "µm"))


def _number(value: float | None) -> Html:
    text = "" if value is None else f"{value:.0f}" if abs(value) >= 100 else f"{value:.2g}"
    return tag("td", text, class_="number")
