"""What surrounds the views: notices, parameters, inputs, versions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

import rig
from sgp._record import ResultRecord
from sgp._report.folder import ResultFolder
from sgp._report.html import Html, tag
from sgp._report.maps import Embedded

_SEVERITIES: Final = {"error": "Error", "warning": "Warning", "info": "Note"}


def sections(folder: ResultFolder, embedded: Embedded | None) -> list[Html]:
    """Return the sections about one result."""
    notices = [*folder.notices, *(embedded.notices if embedded else ())]
    for record in folder.records.values():
        notices += record.notices
    return [
        tag("section", tag("h2", "Notices"), notices_list(notices)),
        *(_record(name, record) for name, record in folder.records.items()),
    ]


def notices_list(notices: Iterable[rig.Notice]) -> Html:
    """Return notices, the most severe ones first, each of them once."""
    ordered = sorted(dict.fromkeys(notices), key=lambda one: [*_SEVERITIES].index(one.severity))
    if not ordered:
        return tag("p", "No notices.")
    return tag(
        "ul",
        (
            tag(
                "li",
                tag("span", f"{_SEVERITIES[one.severity]}: ", class_="severity"),
                str(one),
                " ",
                tag("code", one.code),
                class_=one.severity,
            )
            for one in ordered
        ),
        class_="notices",
    )


def _record(name: str, record: ResultRecord) -> Html:
    return tag(
        "section",
        tag("h2", f"Record {name}"),
        tag("p", f"{record.command}, {record.software.name} {record.software.version}"),
        _details("Figures", _rows(record.metrics)),
        _details("Parameters", _rows(record.parameters)),
        _details("Inputs (SHA-256)", _rows(record.inputs)),
    )


def _details(title: str, rows: Html) -> Html:
    return tag("details", tag("summary", title), tag("div", rows, class_="scroll"))


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
    return "not given" if value is None else str(value)
