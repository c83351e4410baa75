"""The report of result folders: read, reduce, describe, write."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import acquisition
import rig
from sgp._report.folder import ResultFolder, read_folder
from sgp._report.html import Html, tag
from sgp._report.maps import Embedded, embed
from sgp._report.page import colour_maps, page
from sgp._report.planes import Plane
from sgp._report.sections import sections

_PIXELS: Final = 1_300_000
MOST_BYTES: Final = 8_000_000
_MARGIN: Final = 0.93  # of the limit: the size of a reduced page is predicted roughly


@dataclass(eq=False)
class Report:
    """A page, and what there is to report about it."""

    html: str
    notices: list[rig.Notice] = field(default_factory=list)
    reduction: list[float] = field(default_factory=list)


def make_report(paths: Sequence[Path], *, max_pixels: int, most_bytes: int = MOST_BYTES) -> Report:
    """Return the page of some result folders.

    Raises
    ------
    DataError
        If a folder contains nothing that a report can show.
    """
    folders = [read_folder(path) for path in paths]
    pixels = _PIXELS / len(folders)
    while True:
        made = _report(folders, pixels, max_pixels)
        size = len(made.html.encode())
        if size <= most_bytes or pixels < 10_000:
            return made
        pixels *= _MARGIN * most_bytes / size


def _report(folders: Sequence[ResultFolder], pixels: float, max_pixels: int) -> Report:
    made = Report("")
    planes: list[tuple[str, Plane]] = []
    results: list[dict[str, Any]] = []
    body: list[Html] = []
    for number, folder in enumerate(folders):
        embedded = embed(folder, pixels, max_pixels)
        if embedded is None and not folder.records and not folder.notices:
            raise acquisition.DataError(
                f"{folder.path}: contains no record and no map of a result: give the folder that a "
                "command has written"
            )
        if embedded is not None:
            results.append(_described(number, folder, embedded, planes))
            made.notices += embedded.notices
            made.reduction.append(embedded.crop.step)
        made.notices += folder.notices
        body += sections(folder, embedded)
    name = ", ".join(_name(folder) for folder in folders)
    head = [
        tag("header", tag("h1", name), tag("p", "Report of a result", class_="lead")),
        tag("main", tag("div", id="views"), *body),
    ]
    made.html = page(name, head, {"results": results, "colourMaps": colour_maps()}, planes)
    return made


def _described(
    number: int, folder: ResultFolder, embedded: Embedded, planes: list[tuple[str, Plane]]
) -> dict[str, Any]:
    """Return what the scripts have to know of a result, and add its planes."""
    rows, columns = embedded.size
    headers = []
    for plane in embedded.planes.values():
        name = f"plane-{number}-{plane.name}"
        planes.append((name, plane))
        headers.append({"id": name, **plane.header()})
    return {
        "id": str(number),
        "name": _name(folder),
        "rows": rows,
        "columns": columns,
        "full": {"rows": embedded.full[0], "columns": embedded.full[1]},
        "pixelSize": embedded.pixel_size,
        "unit": embedded.unit,
        "planes": headers,
        "lights": [],
    }


def _name(folder: ResultFolder) -> str:
    path = folder.path.absolute()
    return path.name or str(path)
