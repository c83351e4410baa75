"""The report of result folders: read, reduce, describe, write."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any, Final

import acquisition
import rig
from sgp._report.folder import ResultFolder, read_folder
from sgp._report.html import tag
from sgp._report.maps import Embedded, embed
from sgp._report.page import colour_maps, page
from sgp._report.planes import Plane
from sgp._report.prerendered import prerendered
from sgp._report.recording import Recording, read_recording
from sgp._report.sections import image_id, sections
from sgp._result import Result

_PIXELS: Final = 1_300_000
_FEWEST_PIXELS: Final = 1000
MOST_BYTES: Final = 8_000_000
_MARGIN: Final = 0.93  # of the limit: the size of a reduced page is predicted roughly


@dataclass(frozen=True, eq=False)
class Report:
    """A page, what could not be shown, and the reduction of each result."""

    html: str
    notices: list[rig.Notice]
    reduction: list[float]


def make_report(paths: Sequence[Path], *, max_pixels: int, most_bytes: int = MOST_BYTES) -> Report:
    """Return the page of some result folders.

    Raises
    ------
    DataError
        If a folder contains nothing that a report can show.
    """
    folders = [read_folder(path) for path in paths]
    recordings: list[Recording] = []
    pixels = _PIXELS / len(folders)
    while True:
        maps = [embed(folder, pixels, max_pixels) for folder in folders]
        if not recordings:
            recordings = [
                read_recording(folder, one, max_pixels)
                for folder, one in zip(folders, maps, strict=True)
            ]
        parts = [_Part(*part) for part in zip(count(), folders, maps, recordings, strict=False)]
        html = _page(parts)
        size = len(html.encode())
        embedded = [one for one in maps if one is not None]
        planes = sum(len(plane.encoded) for one in embedded for plane in one.planes.values())
        if size <= most_bytes or pixels < _FEWEST_PIXELS or not planes:
            break
        share = max(0.1, _MARGIN * (most_bytes - size + planes) / planes)
        pixels = min(pixels, max(one.size[0] * one.size[1] for one in embedded)) * share
    notices = [notice for part in parts for notice in part.notices]
    return Report(html, notices, [one.crop.step for one in maps if one is not None])


def write_report(path: Path, folder: Path, result: Result, max_pixels: int) -> None:
    """Write the page of a folder whose result is complete but for its record, and add it."""
    made = make_report([folder], max_pixels=max_pixels)
    acquisition.write_durably(path, made.html.encode())
    result.outputs["report"] = path
    known = set(result.warnings)
    result.warnings += [notice for notice in made.notices if notice not in known]
    result.summary.append(f"turn the light in {path}")


@dataclass(frozen=True, eq=False)
class _Part:
    """A result on the page."""

    number: int
    folder: ResultFolder
    maps: Embedded | None
    recording: Recording

    @property
    def name(self) -> str:
        path = self.folder.path.absolute()
        return path.name or str(path)

    @property
    def notices(self) -> list[rig.Notice]:
        of_maps = self.maps.notices if self.maps else []
        return [*self.folder.notices, *of_maps, *self.recording.notices]


def _page(parts: Sequence[_Part]) -> str:
    for part in parts:
        if part.maps is None and not part.folder.records and not part.folder.notices:
            raise acquisition.DataError(
                f"{part.folder.path}: contains no record and no map of a result: give the folder "
                "that a command has written"
            )
    name = ", ".join(part.name for part in parts)
    planes = [
        (_plane_id(part, plane), plane)
        for part in parts
        if part.maps
        for plane in part.maps.planes.values()
    ]
    pictures = [prerendered(part.maps.planes, part.name) for part in parts if part.maps]
    heading = " of {}" if len(parts) > 1 else ""
    body = [
        tag("header", tag("h1", name), tag("p", _lead(parts), class_="lead")),
        tag(
            "main",
            tag("div", id="views"),
            tag("section", *pictures, id="prerendered"),
            *(
                section
                for part in parts
                for section in sections(
                    part.number, part.folder, part.maps, part.recording, heading.format(part.name)
                )
            ),
        ),
    ]
    described = [_described(part, part.maps) for part in parts if part.maps]
    return page(name, body, {"results": described, "colourMaps": colour_maps()}, planes)


def _lead(parts: Sequence[_Part]) -> str:
    """Say what the maps of the page are, and how much they were reduced."""
    texts = []
    for part in parts:
        if part.maps is None:
            texts.append(f"{part.name} has no maps so far")
            continue
        (rows, columns), (high, wide) = part.maps.size, part.maps.crop.size
        full = f"{columns} x {rows} pixels"
        if part.maps.crop.step > 1:
            full += f", reduced from {wide} x {high}"
        if part.maps.unit == "mm":
            full += f", {1000 * part.maps.pixel_size:.3g} µm each"
        texts.append(f"{part.name}: {full}" if len(parts) > 1 else full)
    return "; ".join(texts)


def _plane_id(part: _Part, plane: Plane) -> str:
    return f"plane-{part.number}-{plane.name}"


def _described(part: _Part, maps: Embedded) -> dict[str, Any]:
    """Return what the scripts have to know of a result."""
    rows, columns = maps.size
    lights = part.recording.lights
    directions = (
        {}
        if lights is None
        else dict(zip(lights.ids, lights.unit_directions.tolist(), strict=True))
    )
    images = [
        {
            "id": image_id(part.number, place),
            "name": image.light_id,
            "direction": directions[image.light_id],
        }
        for place, image in enumerate(part.recording.images)
        if part.recording.aligned
        and (image.role, image.status) == ("light", "kept")
        and image.light_id in directions
    ]
    return {
        "id": str(part.number),
        "name": part.name,
        "rows": rows,
        "columns": columns,
        "full": {"rows": maps.full[0], "columns": maps.full[1]},
        "pixelSize": maps.pixel_size,
        "unit": maps.unit,
        "planes": [
            {"id": _plane_id(part, plane), **plane.header()} for plane in maps.planes.values()
        ],
        "lights": [{"id": name, "direction": way} for name, way in directions.items()],
        "images": images,
    }
