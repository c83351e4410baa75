"""The maps that a result was computed from, for a comparison of before and after."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, Literal

import acquisition
import processing
import rig
from sgp._record import ResultRecord
from sgp._report.folder import ResultFolder
from sgp._report.inputs import Inputs, changed_notice

# By command: parameters that name a normal map, and what the page calls it.
_COMPANIONS: Final = {
    "sgp detail separate": {"normals": "Before"},
    "sgp detail combine": {"shape": "Shape component", "detail": "Detail component"},
    "sgp detail fill": {"normals": "Before"},
    "sgp detail superres": {"normals": "Before"},
    "sgp detail transfer": {"target": "Target", "source": "Source of the detail"},
    "sgp detail synthesize": {"onto": "Target", "exemplar": "Exemplar"},
    "sgp detail properties": {"normals": "The map", "targets": "Target"},
}
# Options that state the direction of green, by parameter.
_GREEN: Final = {
    "target": "target_green",
    "source": "source_green",
    "onto": "target_green",
}


def companions(
    folder: ResultFolder, max_pixels: int, notices: list[rig.Notice]
) -> Iterator[tuple[str, processing.NormalMap]]:
    """Yield names and normal maps of the inputs of a result; those that changed are left out."""
    inputs = Inputs(folder)
    for record in folder.records.values():
        for parameter, title in _COMPANIONS.get(record.command, {}).items():
            named = record.parameters.get(parameter)
            paths = named if isinstance(named, list) else [named]
            for path in (folder.located(one) for one in paths if isinstance(one, str)):
                files = inputs.below(path)
                changed = [file for file in files if inputs.state(file) == "changed"]
                if changed and path.exists():
                    notices.append(changed_notice(changed, f"“{title}” is not shown"))
                    continue
                try:
                    found = processing.read_normals(
                        path, green=_green(record, parameter), max_pixels=max_pixels
                    )
                except (acquisition.DataError, acquisition.MissingPathError) as error:
                    text = f"“{title}” is not shown: {error}"
                    notices.append(rig.Notice("map-unreadable", text))
                    continue
                yield f"{title}: {path.name}", found.normal_map


def _green(record: ResultRecord, parameter: str) -> Literal["up", "down"]:
    stated = record.parameters.get(_GREEN.get(parameter, "green"))
    stated = record.parameters.get("green") if stated is None else stated
    return "down" if stated == "down" else "up"
