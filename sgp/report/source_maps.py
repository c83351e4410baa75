"""The maps that a result was computed from, for a comparison of before and after."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import rig
from rig.arrays import Bool
from sgp.cli.options import Green
from sgp.report.folder import Inputs, ResultFolder, changed_notice, noted
from sgp.report.large_maps import Values, read_vectors
from sgp.results import ResultRecord

Companion = tuple[str, Values, Bool]

# By command: parameters that name a normal map, and what the page calls it.
_COMPANIONS: Final = {
    "sgp detail separate": {"normals": "Before"},
    "sgp detail combine": {"shape": "Shape component", "detail": "Detail component"},
    "sgp detail fill": {"normals": "Before"},
    "sgp detail superres": {"normals": "Before"},
    "sgp detail transfer": {"target": "Target", "source": "Source of the detail"},
    "sgp detail synthesize": {"onto": "Target", "exemplar": "Exemplar"},
    "sgp detail properties": {"normals": "The map", "targets": "Target"},
    "sgp curvature": {"normals": "Normals"},
    "sgp surface": {"normals": "Normals"},
    "sgp compare": {"a": "First map", "b": "Second map"},
    "sgp compare --register": {"a": "Before"},
}
# By command: outputs that the picture of the result does not show.
_OWN: Final = {"sgp detail separate": {"shape": "Shape component"}}
# Options that state the direction of green, by parameter.
_GREEN: Final = {"target": "target_green", "source": "source_green", "onto": "target_green"}


def companions(
    folder: ResultFolder, max_pixels: int, notices: list[rig.Notice]
) -> Iterator[Companion]:
    """Yield names, normals and masks of the inputs of a result; those that changed are left out.

    Maps of its own that its picture does not show follow.
    """
    inputs = Inputs(folder)
    change = change_of(folder)
    for name, record in folder.records.items():
        command = "sgp compare --register" if record is change else record.command
        for parameter, title in _COMPANIONS.get(command, {}).items():
            if title == "Normals" and folder.file("normals.exr"):
                continue
            named = record.parameters.get(parameter)
            paths = named if isinstance(named, list) else [named]
            for path in (folder.located(one) for one in paths if isinstance(one, str)):
                files = inputs.below(path)
                changed = [file for file in files if inputs.state(file) == "changed"]
                if changed and path.exists():
                    notices.append(changed_notice(changed, f"“{title}” is not shown"))
                    continue
                green = _green(record, parameter)
                yield from _read(f"{title}: {path.name}", path, green, max_pixels, notices)
        for output, title in _OWN.get(record.command, {}).items():
            if output in record.outputs:
                path = (folder.path / name).parent / record.outputs[output]
                yield from _read(title, path, "up", max_pixels, notices)


def change_of(folder: ResultFolder) -> ResultRecord | None:
    """Return the record if the maps are those after a change, on the pixels of those before."""
    record = folder.main
    if record is None or record.command != "sgp compare":
        return None
    return record if record.parameters.get("register") is True else None


def _read(
    name: str, path: Path, green: Green, max_pixels: int, notices: list[rig.Notice]
) -> Iterator[Companion]:
    with noted(notices, "map", f"“{name.partition(':')[0]}” is not shown: "):
        yield name, *read_vectors(path, max_pixels, green)


def _green(record: ResultRecord, parameter: str) -> Green:
    stated = record.parameters.get(_GREEN.get(parameter, "green"))
    stated = record.parameters.get("green") if stated is None else stated
    return "down" if stated == "down" else "up"
