"""lights.json: the record of `Lights`, one line per light, and what the writer adds."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import ConfigDict, Field, model_validator

from acquisition._errors import DataError
from acquisition._json import parse_json
from acquisition._session.lights_record import ERROR_KEYS, LightsRecord
from acquisition._session.value_records import Table
from acquisition._values.lights import Lights

_READ: Final = (1, 2)
# Keys that version 2 added to the file; to the lights it added those of their errors.
_ADDED: Final = "calibrated"


class _Head(Table):
    model_config = ConfigDict(extra="ignore")

    format: Literal["sgp-lights"]
    version: Any


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


def parse_lights_json(text: str, path: Path) -> Lights:
    """Build lights from the text of a lights.json.

    Raises
    ------
    DataError
        If the text is invalid or has another version; the message names ``path`` and the light.
    """
    version = parse_json(_Head, text, path).version
    if type(version) is not int or version not in _READ:
        raise DataError(
            f"{path}: version {version!r} of sgp-lights is unknown, this program reads "
            f"{' and '.join(map(str, _READ))}: use the program that wrote the file"
        )
    file = parse_json(_LightsFile, text, path)
    try:
        return file.value()
    except DataError as error:
        raise DataError(f"{path}: {error}") from error


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
