"""Recipes: the options of the commands that a batch runs for each source."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import acquisition
import rig

# Tables of a recipe, in the order of the commands.
TABLES = ("calibrate", "run", "roughness", "report")
_GIVEN = ("out", "force", "json", "debug")
# Words in braces that stand for a source.
_OF_A_SOURCE = ("source", "name", "parent")

Value = bool | int | float | str | Sequence[object]


@dataclass(frozen=True)
class Recipe:
    """The options for each source.

    Parameters
    ----------
    run
        Options of ``sgp run`` by their long names.
    calibrate
        Options of ``sgp calibrate spheres``, and its ``recordings``; None if the sources bring
        their lights or the options of ``run`` name them.
    roughness
        Options of ``sgp roughness``; None if it is not measured.
    report
        Options of ``sgp report``; None to keep the page that ``sgp run`` writes.
    folder
        Folder of the recipe, to which its paths are relative.
    """

    run: Mapping[str, Value] = field(default_factory=dict)
    calibrate: Mapping[str, Value] | None = None
    roughness: Mapping[str, Value] | None = None
    report: Mapping[str, Value] | None = None
    folder: Path = field(default_factory=Path.cwd)


def read_recipe(path: Path) -> Recipe:
    """Read a recipe.

    Raises
    ------
    MissingPathError
        If there is no such file.
    DataError
        If it is not TOML, has an unknown table, or an option that the batch itself gives.
    """
    try:
        content = rig.files.parse_toml(rig.read_bounded(path))
    except FileNotFoundError as error:
        raise acquisition.missing_path(path) from error
    except rig.UnreadableError as error:
        raise acquisition.DataError(f"{path}: {error}") from error
    for name, table in content.items():
        if name not in TABLES or not isinstance(table, dict):
            known = ", ".join(f"[{one}]" for one in TABLES)
            raise acquisition.DataError(f"{path}: {name!r} is unknown: a recipe may have {known}")
        for key, value in table.items():
            _check(f"{path}: [{name}] {key}", key, value)
    calibrate = content.get("calibrate")
    if calibrate is not None and not calibrate.get("recordings"):
        text = 'recordings is missing: give, for instance, recordings = ["{parent}/balls"]'
        raise acquisition.DataError(f"{path}: [calibrate] {text}")
    if calibrate is not None and {"lights", "spheres"} & content.get("run", {}).keys():
        text = "[calibrate] and [run] both give the lights: remove one of them"
        raise acquisition.DataError(f"{path}: {text}")
    return Recipe(**{"run": {}} | content, folder=path.absolute().parent)


def _check(place: str, key: str, value: object) -> None:
    if key.replace("_", "-") in _GIVEN:
        raise acquisition.DataError(f"{place}: the batch itself gives this option: remove it")
    values = value if isinstance(value, list) else [value]
    if not all(isinstance(one, (bool, int, float, str)) for one in values):
        raise acquisition.DataError(
            f"{place}: give text, a number, true, false, or a list of these"
        )


def option_words(options: Mapping[str, Value], places: Mapping[str, str]) -> list[str]:
    """Return options as words of a command line, with ``{source}`` and so on replaced."""
    words = []
    for key, value in options.items():
        name = key.replace("_", "-")
        for one in value if isinstance(value, list) else [value]:
            if isinstance(one, bool):
                words += [f"--{name}"] if one else []
            else:
                words.append(f"--{name}={placed(one, places)}")
    return words


def places_of(source: Path) -> dict[str, str]:
    """Return what the words in braces stand for."""
    values = (str(source), source.name, str(source.parent))
    return dict(zip(_OF_A_SOURCE, values, strict=True))


def is_placed(text: str) -> bool:
    """Return whether a text has one of the words in braces, and so differs between sources."""
    return any(f"{{{word}}}" in text for word in _OF_A_SOURCE)


def placed(value: object, places: Mapping[str, str]) -> str:
    """Return a value as text, with the words in braces replaced; other braces stay."""
    text = str(value)
    for word, place in places.items():
        text = text.replace(f"{{{word}}}", place)
    return text
