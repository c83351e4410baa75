"""Files of lights, whatever their kind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from acquisition._errors import DataError
from acquisition._storage import write_durably
from acquisition._text_files import read_text
from acquisition._value_files.lights_json import lights_json, parse_lights_json
from acquisition._value_files.lights_text import (
    DIRECTIONS_FILE,
    lp_text,
    parse_directions,
    parse_lp,
)
from acquisition._values.lights import Lights


def read_lights(path: str | Path) -> Lights:
    """Read lights.

    Parameters
    ----------
    path
        ``.json`` (ours), ``.lp`` (RTI: a count, then ``file x y z`` a line), any other text of N
        rows of three numbers, or a DiLiGenT folder or its light_directions.txt, whose
        light_intensities.txt and filenames.txt are then read too.

    Returns
    -------
    Lights
        Vectors need not be unit in the file. The ids are those of lights.json, the file names of
        .lp and of filenames.txt, else L00, L01, ...

    Raises
    ------
    MissingPathError
        If there is no such file.
    DataError
        If it is not understood; the message names the file, and the line or light.
    """
    path = Path(path)
    if path.is_dir():
        if not (path / DIRECTIONS_FILE).exists():
            raise DataError(f"{path}: holds no {DIRECTIONS_FILE}: name a file of lights")
        path = path / DIRECTIONS_FILE
    text = read_text(path)
    match path.suffix.lower():
        case ".json":
            return parse_lights_json(text, path)
        case ".lp":
            return parse_lp(text, path)
    return parse_directions(text, path)


def write_lights(
    path: str | Path, lights: Lights, provenance: dict[str, Any] | None = None
) -> None:
    """Write lights as ``.json``, which keeps everything, or as ``.lp``.

    Parameters
    ----------
    path
        The suffix chooses. An ``.lp`` holds only ids and unit directions: near lights are written
        as seen from the origin, and intensities are lost.
    lights
        What to write.
    provenance
        Where they come from, for ``.json`` only: names and finite values that JSON can hold.

    Raises
    ------
    DataError
        If the suffix is another.
    StorageError
        If the disk refuses the write.
    """
    path = Path(path)
    match path.suffix.lower():
        case ".json":
            text = lights_json(lights, provenance or {})
        case ".lp":
            text = lp_text(lights)
        case _:
            raise DataError(f"{path}: lights are written as .json or .lp: choose one of the two")
    write_durably(path, text.encode())
