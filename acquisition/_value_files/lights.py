"""Reader and writer for files of lights in all supported formats."""

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
from acquisition._value_files.near_lights import is_near_lights
from acquisition._values.lights import Lights
from rig import check_type


def read_lights(path: str | Path) -> Lights:
    r"""Read lights.

    Parameters
    ----------
    path
        ``.json`` of our own format; ``.lp`` of RTI with a count, then one line ``file x y z`` per
        light; any other text with N rows of three numbers, with or without a name before them; or a
        DiLiGenT folder or its light_directions.txt, in which case light_intensities.txt and
        filenames.txt are read too. Rows are separated by white space, tabs, commas or semicolons; a
        first line may name the columns. A fourth number is used as intensity if it varies near 1.

    Returns
    -------
    Lights
        Lights of the file, whose vectors may have any length there. The ids are those of
        lights.json, or the file names in the .lp or in filenames.txt, or else L00, L01, ...
        `Lights.warnings` say what was assumed, and if lengths are not used that may be distances.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If the file is invalid; the message names the file, and the line or light. Files of near
        lights from elsewhere are read by `read_near_lights`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from acquisition import read_lights
    >>> _ = Path("cat.lp").write_text("2\ncat.0.png 0 0 1\ncat.1.png 0 1 1\n")
    >>> lights = read_lights("cat.lp")
    >>> lights.ids, lights.unit_directions[1].round(3)
    (('cat.0.png', 'cat.1.png'), array([0.   , 0.707, 0.707]))
    """
    path = Path(path)
    if path.is_dir():
        if not (path / DIRECTIONS_FILE).exists():
            raise DataError(f"{path}: has no {DIRECTIONS_FILE}: give a file of lights")
        path = path / DIRECTIONS_FILE
    if is_near_lights(path):
        raise DataError(
            f"{path}: near lights in axes that the file does not state: import the recording with "
            "its lights and its camera, which converts them"
        )
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
    """Write lights as ``.json``, which is lossless, or as ``.lp``.

    Parameters
    ----------
    path
        Output file; its suffix selects the format. An ``.lp`` file holds only ids and unit
        directions: near lights are written as directions from the origin, and intensities are lost.
    lights
        Lights to write.
    provenance
        Origin of the lights, for ``.json`` only: names with finite values that JSON can hold.

    Raises
    ------
    DataError
        If the file has another suffix.
    StorageError
        If the file cannot be written.

    Examples
    --------
    >>> from acquisition import Lights, read_lights, write_lights
    >>> write_lights("lights.json", Lights(directions=[[1, 0, 1], [0, 1, 1]]))
    >>> read_lights("lights.json")
    Lights(2 directions, L00 to L01)
    """
    check_type("lights", lights, Lights, "Lights(directions)")
    path = Path(path)
    match path.suffix.lower():
        case ".json":
            text = lights_json(lights, provenance or {})
        case ".lp":
            text = lp_text(lights)
        case _:
            raise DataError(f"{path}: lights are written as .json or .lp: choose one of the two")
    write_durably(path, text.encode())
