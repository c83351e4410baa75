"""The report of result folders: read, reduce, describe, write."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any, Final

import acquisition
import rig
from sgp.report.certificate import certificate
from sgp.report.folder import ResultFolder, read_folder
from sgp.report.html import Html, tag
from sgp.report.maps import (
    Embedded,
    FolderMaps,
    camera_of,
    embed,
    embed_beside,
    height_differences,
    resolution_of,
)
from sgp.report.page import colour_maps, page
from sgp.report.planes import SIDE
from sgp.report.prerendered import prerendered
from sgp.report.recording import Recording, read_bare_recording, read_recording
from sgp.report.scripts import VIEWS
from sgp.report.sections import Part, identity_list, image_id, marked, sections
from sgp.report.source_maps import Companion, change_of, companions
from sgp.report.verdict import verdict_box
from sgp.results import Result

_PIXELS: Final = 1_300_000
_FEWEST_PIXELS: Final = 1000
MOST_BYTES: Final = 8_000_000
_MARGIN: Final = 0.97  # of the limit: the size of a page is estimated
_POWER: Final = 1.15  # of the pixels: smaller maps need more bytes for each


@dataclass(frozen=True, eq=False)
class Report:
    """A page, what could not be shown, and the reduction of each result, also in words."""

    html: str
    notices: list[rig.Notice]
    reduction: list[float]
    reduced: list[str]


def make_report(
    paths: Sequence[Path],
    *,
    max_pixels: int,
    full: bool = False,
    most_bytes: int = MOST_BYTES,
    unrecorded: Sequence[rig.Notice] = (),
    check: Path | None = None,
) -> Report:
    """Return the page of some result folders.

    Without ``full``, maps are reduced until the page has at most ``most_bytes``. ``unrecorded`` are
    notices about the first result that its records do not have yet, ``check`` a comparison of
    calibrations for certificates.

    Raises
    ------
    DataError
        If a folder contains nothing that a report can show, or the comparison does not contain the
        lights of a result, or no result has a certificate.
    """
    found = [read_folder(path) for path in paths]
    if check is not None and not any(one.roughness for one in found):
        raise acquisition.DataError(
            f"{check}: is for certificates, and no result of sgp roughness is given"
        )
    folders = [_Folder(one, max_pixels, check) for one in found]
    folders[0].add_unrecorded(unrecorded)
    pixels = _PIXELS / len(folders)
    rest: int | None = None
    while True:
        parts: list[Part] = []
        for folder in folders:
            parts += folder.parts(len(parts), pixels, full)
        embedded = [part.maps for part in parts if part.maps]
        last = full or not embedded or pixels < _FEWEST_PIXELS
        if rest is None and not last:
            rest = len(_page(parts, maps=False).encode())
        planes = 0.0 if last else sum(p.estimated for one in embedded for p in one.planes.values())
        room = most_bytes - (rest or 0)
        if last or planes <= room:
            html = _page(parts)
            excess = len(html.encode()) - most_bytes
            if last or excess <= 0:
                break
            planes = room + excess
        share = max(0.1, _MARGIN * room / planes) ** _POWER
        pixels = min(pixels, max(one.size[0] * one.size[1] for one in embedded)) * share
    notices = [notice for part in parts for notice in part.notices]
    shown = [(part.name, part.maps) for part in parts if part.folder and part.maps]
    reduction = [1.0 if maps.tiles else maps.crop.step for _, maps in shown]
    reduced = [
        _reduced(name, maps) for name, maps in shown if not maps.tiles and maps.crop.step > 1
    ]
    return Report(html, notices, reduction, reduced)


def _reduced(name: str, maps: Embedded) -> str:
    (rows, columns), (high, wide) = maps.size, maps.crop.size
    return f"the page shows {name} reduced from {wide} x {high} to {columns} x {rows} pixels"


def write_report(path: Path, folder: Path, result: Result, max_pixels: int) -> None:
    """Write the page of a folder whose result is complete but for its record, and add it."""
    made = make_report([folder], max_pixels=max_pixels, unrecorded=result.warnings)
    acquisition.write_durably(path, made.html.encode())
    result.outputs["report"] = path
    known = set(result.warnings)
    result.warnings += [notice for notice in made.notices if notice not in known]
    result.summary += [f"turn the light in {path}", *made.reduced]


class _Folder:
    """A folder whose maps, inputs and recording are read once."""

    def __init__(self, folder: ResultFolder, max_pixels: int, check: Path | None) -> None:
        self._folder = folder
        self._check = check
        self._max_pixels = max_pixels
        self._maps = FolderMaps(folder, max_pixels)
        self._recording: Recording | None = None
        self._notices: list[rig.Notice] = []
        self._beside: list[Companion] = []
        self._certificate: Sequence[Html] = ()

    def add_unrecorded(self, notices: Sequence[rig.Notice]) -> None:
        """Add those of some notices that no record has."""
        known = {
            (one.code, one.text)
            for record in self._folder.records.values()
            for one in record.notices
        }
        self._notices += [one for one in notices if (one.code, one.text) not in known]

    def parts(self, first: int, pixels: float, full: bool) -> Iterator[Part]:
        """Yield the result, and the maps that it was computed from."""
        maps = embed(self._maps, pixels, full=full)
        folder, numbers = self._folder, count(first)
        if self._recording is None:
            self._recording = _recording(folder, maps, self._max_pixels)
            self._certificate = certificate(
                folder, self._recording, self._max_pixels, self._notices, self._check
            )
            if maps is not None:
                self._beside = list(companions(folder, self._max_pixels, self._notices))
        notices = [
            *folder.notices,
            *(maps.notices if maps else ()),
            *self._recording.notices,
            *self._notices,
        ]
        path = folder.path.absolute()
        name = path.name or str(path)
        yield Part(next(numbers), name, maps, folder, self._recording, notices, self._certificate)
        if maps is not None:
            for name, values, mask in self._beside:
                beside = embed_beside(values, mask, maps, pixels, full=full)
                yield Part(next(numbers), name, beside)


def _recording(folder: ResultFolder, maps: Embedded | None, max_pixels: int) -> Recording:
    if maps is not None or folder.records or folder.notices:
        return read_recording(folder, maps, max_pixels)
    try:
        return read_bare_recording(folder.path, max_pixels)
    except acquisition.DataError as error:
        raise acquisition.DataError(
            f"{folder.path}: contains no record and no map of a result: give the folder that a "
            f"command has written. It is no recording either: {error}"
        ) from error


def _page(parts: Sequence[Part], *, maps: bool = True) -> str:
    """Return the page; without ``maps``, all of it but the encoded maps."""
    folders = [part for part in parts if part.folder]
    identities: dict[acquisition.Identity, list[str]] = {}
    for part in folders:
        for one in part.identities:
            identities.setdefault(one, []).append(part.name)
    name = marked(", ".join(part.name for part in folders), identities)
    shown = [(part, part.maps) for part in parts if part.maps]
    planes = [
        (_plane_id(part, plane.name), plane.encoded if maps else "")
        for part, found in shown
        for plane in found.planes.values()
    ]
    planes += [
        (_plane_id(part, one.key), one.encoded) for part, found in shown for one in found.tiles
    ]
    pictures = [
        prerendered(found.planes, part.name, titled=len(shown) > 1) for part, found in shown
    ]
    several = len(folders) > 1
    recorded = (identity_list(one, names if several else ()) for one, names in identities.items())
    verdicts = (
        verdict_box(part.folder, f" ({part.name})" if several else "")
        for part in folders
        if part.folder is not None
    )
    boxes = [box for box in verdicts if box is not None]
    lead = tag("p", _lead(parts), class_="lead")
    header = tag("header", tag("h1", name), lead, boxes, recorded)
    about = (sections(part, f" of {part.name}" if several else "") for part in folders)
    views = tag("div", id="views"), tag("section", *pictures, id="prerendered")
    described = [_described(part, found) for part, found in shown]
    report = {"results": described, "colourMaps": colour_maps()}
    with_heights = any("height" in found.planes for _, found in shown)
    body = header, tag("main", *views, *about)
    return page(name, body, report, planes, VIEWS if with_heights else ())


def _lead(parts: Sequence[Part]) -> str:
    """Say what the maps of the page are, and how much they were reduced."""
    texts = []
    for part in parts:
        if part.maps is None:
            none = f"{part.name} has no maps so far"
            if part.certificate:
                none = f"{part.name}: parameters of the surface"
            elif part.folder and not part.folder.records and part.recording.images:
                none = f"{part.name} is a recording without a result: sgp run computes one"
            texts.append(none)
            continue
        (rows, columns), (high, wide) = part.maps.size, part.maps.crop.size
        full = f"{columns} x {rows} pixels"
        if part.maps.tiles:
            full = f"{wide} x {high} pixels in tiles, and {columns} x {rows} for overviews"
        elif part.maps.crop.step > 1:
            full += f", reduced from {wide} x {high}"
        if part.maps.unit == "mm":
            size = part.maps.pixel_size / (part.maps.crop.step if part.maps.tiles else 1)
            full += f", {rig.figure(1000 * size, 3)} µm each"
        texts.append(f"{part.name}: {full}" if len(parts) > 1 else full)
    return "; ".join(texts)


def _plane_id(part: Part, name: str) -> str:
    return f"plane-{part.number}-{name}"


def _described(part: Part, maps: Embedded) -> dict[str, Any]:
    """Return what the scripts have to know of a result."""
    rows, columns = maps.size
    change = change_of(part.folder) if part.folder else None
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
        and image.known
        and (image.role, image.status) == ("light", "kept")
        and image.light_id in directions
    ]
    return {
        "id": str(part.number),
        "name": f"After: {Path(str(change.parameters['b'])).name}" if change else part.name,
        "change": change is not None,
        "rows": rows,
        "columns": columns,
        "full": {"rows": maps.full[0], "columns": maps.full[1]},
        "pixelSize": maps.pixel_size,
        "unit": maps.unit,
        "reduction": maps.crop.step,
        "heightDifferences": None if part.folder is None else height_differences(part.folder),
        "camera": None if part.folder is None else camera_of(part.folder, maps),
        "roughness": None if part.folder is None else resolution_of(part.folder, maps),
        "marked": not maps.mostly_invented,
        "planes": [
            {"id": _plane_id(part, plane.name), **plane.header()} for plane in maps.planes.values()
        ],
        "tiles": _tiles(part, maps),
        "lights": [{"id": name, "direction": way} for name, way in directions.items()],
        "images": images,
    }


def _tiles(part: Part, maps: Embedded) -> dict[str, Any] | None:
    if not maps.tiles:
        return None
    rows, columns = maps.crop.size
    headers = {one.key: {"id": _plane_id(part, one.key), **one.header} for one in maps.tiles}
    return {"side": SIDE, "rows": rows, "columns": columns, "headers": headers}
