"""What surrounds the views: notices, parameters, inputs, versions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import acquisition
import rig
from sgp.report.changes import changes_section
from sgp.report.folder import ResultFolder
from sgp.report.html import Html, details, tag
from sgp.report.lights import lights_section
from sgp.report.maps import Embedded
from sgp.report.recording import Image, Recording
from sgp.results import ResultRecord

_NOT_GIVEN: Final[tuple[object, ...]] = (None, False, [], "")
_SEVERITIES: Final = ("error", "warning", "info")


@dataclass(frozen=True, eq=False)
class Part:
    """A result on the page, or a map that one was computed from (without a folder).

    ``notices`` are those besides the ones of its records; ``certificate`` is that of a measurement
    of roughness.
    """

    number: int
    name: str
    maps: Embedded | None
    folder: ResultFolder | None = None
    recording: Recording = field(default_factory=Recording)
    notices: list[rig.Notice] = field(default_factory=list)
    certificate: Sequence[Html] = ()

    @property
    def identities(self) -> Sequence[acquisition.Identity]:
        """What the recordings were of: by the records, or by the recording that is still there."""
        stated = () if self.folder is None else self.folder.recordings
        return stated or self.recording.identities


def sections(part: Part, heading: str) -> list[Html]:
    """Return the sections about a result; ``heading`` names it if there are several."""
    folder, recording, number = part.folder, part.recording, part.number
    if folder is None:
        return []
    noted = [*part.notices, *(one for record in folder.records.values() for one in record.notices)]
    planes = part.maps.planes.values() if part.maps else ()
    lead = tag("p", "Colour scales leave out 0.5 % of the pixels at each end.", class_="lead")
    maps = lead, tag("div", id=f"maps-{number}", class_="maps")
    lights = recording.lights
    contents: dict[str, Html | Sequence[Html]] = {
        "Certificate": part.certificate,
        "Changes": changes_section(folder),
        "Notices": notices_list(noted),
        "Maps": maps if any(plane.kind == "scalar" for plane in planes) else (),
        "Recording": _contact_sheet(number, recording) if recording.images else (),
        "Lights": () if lights is None else lights_section(folder, lights),
        "Records": [_record(name, record) for name, record in folder.records.items()],
    }
    return [
        tag("section", tag("h2", title, heading), content, class_=title.lower())
        for title, content in contents.items()
        if content
    ]


def _contact_sheet(number: int, recording: Recording) -> Html:
    shown, total = len(recording.images), recording.total
    rejected = sum(image.status == "rejected" for image in recording.images)
    count = f"{total} images" if shown == total else f"{shown} of {total} images"
    lead = f"{count}, {rejected} of them rejected. " if rejected else f"{count}. "
    lead += "Images of the same exposure time are shown equally bright."
    figures = []
    for place, image in enumerate(recording.images):
        name, own = f"Image {image.name}", image_id(number, place)
        picture = tag("img", src=image.source, alt=name, id=own)
        caption = tag("figcaption", _caption(image))
        figures.append(tag("figure", picture, caption, class_=image.status))
    return tag("div", tag("p", lead, class_="lead"), tag("div", figures, class_="contact"))


def image_id(number: int, place: int) -> str:
    """Return the id of an image of a result, which the scripts use."""
    return f"image-{number}-{place}"


def _caption(image: Image) -> str:
    role = "" if image.role == "light" else f" {image.role}"
    exposure = "" if image.exposure_us is None else f", {_milliseconds(image.exposure_us)}"
    rejected = ", REJECTED" if image.status == "rejected" else ""
    return f"{image.light_id}{role}{exposure}{rejected}"


def _milliseconds(exposure_us: float) -> str:
    return f"{exposure_us / 1000:g} ms" if exposure_us >= 1000 else f"{exposure_us:g} µs"


def notices_list(notices: Iterable[rig.Notice]) -> Html:
    """Return notices, the most severe ones first, each of them once."""
    ordered = sorted(dict.fromkeys(notices), key=lambda one: _SEVERITIES.index(one.severity))
    if not ordered:
        return tag("p", "No notices.")
    items = []
    for one in ordered:
        severity = tag("span", f"{one.label.capitalize()}: ", class_="severity")
        items.append(tag("li", severity, str(one), " ", tag("code", one.code), class_=one.severity))
    return tag("ul", items, class_="notices")


def _record(name: str, record: ResultRecord) -> Html:
    stated = {key: value for key, value in record.parameters.items() if value not in _NOT_GIVEN}
    given = {key: value for key, value in stated.items() if key not in record.defaults}
    defaults = {key: value for key, value in stated.items() if key in record.defaults}
    return tag(
        "div",
        tag("h3", name),
        tag("p", f"{record.command}, {record.software.name} {record.software.version}"),
        details("Figures", _rows(record.metrics)),
        details("Parameters", _rows(given)),
        details("Parameters with default values", _rows(defaults)) if defaults else (),
        details("Inputs (SHA-256)", _rows(record.inputs)),
    )


def _rows(values: Mapping[str, object]) -> Html:
    rows = (
        tag("tr", tag("th", key, scope="row"), tag("td", tag("code", _shown(value))))
        for key, value in values.items()
    )
    return tag("table", rows)


def _shown(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, dict):
        return ", ".join(f"{key} {_shown(item)}" for key, item in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_shown, value)) or "none"
    return "not defined" if value is None else str(value)


_TERMS: Final = {
    "object": "Object",
    "operator": "Operator",
    "place": "Place",
    "started_utc": "Recorded",
    "notes": "Notes",
    "rights": "Rights",
}


def identity_list(identity: acquisition.Identity, results: Sequence[str] = ()) -> Html:
    """Return the texts of a recording that are not empty, with their terms.

    ``results`` are the names of the results, if the page has others.
    """
    texts = ((term, str(getattr(identity, key))) for key, term in _TERMS.items())
    rows = ((tag("dt", term), tag("dd", _lines(text))) for term, text in texts if text)
    origin = (tag("dt", "Origin"), tag("dd", "SIMULATED")) if identity.simulated else ()
    named = (tag("dt", "Results"), tag("dd", ", ".join(results))) if results else ()
    return tag("dl", named, origin, (cell for row in rows for cell in row), class_="identity")


def _lines(text: str) -> list[str]:
    """Return the lines of a text with breaks between them."""
    return [part for line in text.splitlines() for part in (line, tag("br"))][:-1]


def marked(title: str, identities: Iterable[acquisition.Identity]) -> str:
    """Return a title that says whether a recording is simulated."""
    return f"SIMULATED: {title}" if any(one.simulated for one in identities) else title
