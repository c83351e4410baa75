"""Files of lights in all supported formats; ``lights.json`` has one line per light."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field, model_validator

from acquisition._errors import DataError, named
from acquisition.files.storage import write_durably
from acquisition.files.text_files import parse_versioned, read_text
from acquisition.session.lights_record import ERROR_KEYS, LightsRecord
from acquisition.session.manifest import RigRecord
from acquisition.value_files.lights_text import (
    DIRECTIONS_FILE,
    lp_text,
    parse_directions,
    parse_lp,
)
from acquisition.value_files.near_lights import is_near_lights
from acquisition.values.light_errors import LightErrors
from acquisition.values.lights import Lights
from acquisition.values.setup import Calibrated, Setup
from rig import RigConfig, check_type

# Keys that version 2 added to the file; to the lights it added those of their errors.
_ADDED: Final = "calibrated"


class _LightsFile(LightsRecord):
    format: Literal["sgp-lights"]
    version: Literal[1, 2]
    provenance: Annotated[dict[str, Any], Field(default_factory=dict)]

    @model_validator(mode="after")
    def _keys_of_the_version(self) -> _LightsFile:
        if self.version == 1:
            added = {_ADDED} & self.model_fields_set
            for i, light in enumerate(self.lights):
                keys = ERROR_KEYS.keys() & light.model_fields_set
                added |= {f"lights.{i}.{key}" for key in keys}
            if added:
                raise ValueError(f"unknown key {min(added)!r}: version 1 does not have it")
        return self


def lights_json(lights: Lights, provenance: dict[str, Any]) -> str:
    """Return the text of a lights.json: version 1 if this version can hold the lights, else 2."""
    record = LightsRecord.of(lights)
    rows = [json.dumps(light.model_dump(exclude_none=True)) for light in record.lights]
    version = 1 if lights.errors is None and lights.calibrated is None else 2
    calibrated = ""
    if record.calibrated is not None:
        calibrated = f' "calibrated": {record.calibrated.json_text()},\n'
    return (
        f'{{\n "format": "sgp-lights",\n "version": {version},\n "lights": [\n  '
        + ",\n  ".join(rows)
        + f'\n ],\n{calibrated} "provenance": {json.dumps(provenance, allow_nan=False)}\n}}\n'
    )


def read_lights(path: str | Path) -> Lights:
    r"""Read lights.

    Parameters
    ----------
    path
        ``.json`` of our own format; ``.lp`` of RTI with a count, then one line ``file x y z`` per
        light; any other text with N rows of three numbers, with or without a name before them; or a
        DiLiGenT folder or its light_directions.txt, in which case light_intensities.txt and
        filenames.txt are read too. A first line may name the columns; names are in that of
        ``name``, ``file``, ``filename`` or ``image``, else in the only one of differing words. The
        separator is the first of semicolon, tab, comma with a space, white space and comma that
        fits all rows; other commas are decimal commas. A fourth number is an intensity if its
        column says so, or if it varies within a factor of 2 of 1 (``light-column-assumed``); a
        constant one is not used, others are refused. Vectors of different lengths, or of 20 and
        more, count as directions (``light-lengths-unused``).

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
            file = parse_versioned(_LightsFile, text, path)
            with named(path):
                return file.value()
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


def lights_of_rig(config: RigConfig | RigRecord) -> Lights:
    """Return the lights of a rig: its LEDs at the positions that its rig file states.

    Their strengths are not known and count as equal; they shine alike in all directions.

    Parameters
    ----------
    config
        Configuration of the rig, or what a session has recorded of it.

    Returns
    -------
    Lights
        All LEDs by their ids, ``L07`` for LED 7, with the covariances of their positions.

    Raises
    ------
    DataError
        If the configuration has no ``led_positions_mm``.

    Examples
    --------
    >>> from acquisition.value_files import lights_of_rig
    >>> from rig import RigConfig
    >>> places = [[300, 0, 300], [0, 310, 300], [-280, 0, 300]]
    >>> lights_of_rig(RigConfig(name="arc", driver="bench", leds=3, led_positions_mm=places))
    Lights(3 positions in mm, L00 to L02)
    """
    if not isinstance(config, RigRecord):
        check_type("config", config, RigConfig, "rig.find_rig_config(name) returns one")
    if not config.led_positions_mm or not config.led_positions_sigma_mm:
        raise DataError(f"the rig {config.name} has no led_positions_mm: add them to its rig file")
    covariance = config.led_positions_sigma_mm**2 * np.eye(3)
    return Lights(
        positions_mm=np.array(config.led_positions_mm),
        errors=LightErrors(np.tile(covariance, (len(config.led_positions_mm), 1, 1))),
        calibrated=Calibrated(setup=Setup(rig=config.name)),
    )
