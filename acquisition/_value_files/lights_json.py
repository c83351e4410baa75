"""lights.json: all data of `Lights`, one line per light, and their origin."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from acquisition._errors import DataError
from acquisition._json import parse_json
from acquisition._value_files.calibrated_record import CalibratedRecord, FileRecord
from acquisition._values.light_errors import Array, LightErrors
from acquisition._values.lights import Lights

_Vector = tuple[float, float, float]
_Deviation = Annotated[float, Field(ge=0)]

_READ: Final = (1, 2)
# Keys that version 2 added: of the lights with their fields of `LightErrors`, and of the file.
_ADDED_TO_LIGHTS: Final = {
    "covariance_mm2": "covariances",
    "covariance_rad2": "covariances",
    "intensity_std": "intensity_std",
    "axis_std_deg": "axis_std_deg",
    "mu_std": "mu_std",
    "residual_px": "residual_px",
    "spheres": "spheres",
}
_ADDED_TO_FILE: Final = "calibrated"
_OF_THE_OTHER_KIND: Final = {
    "direction": ("covariance_mm2", "axis_std_deg", "mu_std"),
    "position": ("covariance_rad2",),
}


class _Head(FileRecord):
    model_config = ConfigDict(extra="ignore")

    format: Literal["sgp-lights"]
    version: Any


class _Light(FileRecord):
    id: str
    direction: _Vector | None = None
    position_mm: _Vector | None = None
    intensity: _Vector = (1.0, 1.0, 1.0)
    axis: _Vector | None = None
    mu: Annotated[float, Field(ge=0)] = 0.0
    covariance_mm2: tuple[_Vector, _Vector, _Vector] | None = None
    covariance_rad2: tuple[tuple[float, float], tuple[float, float]] | None = None
    intensity_std: tuple[_Deviation, _Deviation, _Deviation] | None = None
    axis_std_deg: _Deviation | None = None
    mu_std: _Deviation | None = None
    residual_px: _Deviation | None = None
    spheres: Annotated[int, Field(ge=1)] | None = None

    @model_validator(mode="after")
    def _one_vector(self) -> _Light:
        if (self.direction is None) == (self.position_mm is None):
            raise ValueError("a light needs either direction or position_mm")
        kind = "direction" if self.position_mm is None else "position"
        for key in _OF_THE_OTHER_KIND[kind]:
            if getattr(self, key) is not None:
                raise ValueError(f"a light with a {kind} has no {key}")
        return self


class _LightsFile(FileRecord):
    format: Literal["sgp-lights"]
    version: Literal[1, 2]
    lights: Annotated[tuple[_Light, ...], Field(min_length=1)]
    calibrated: CalibratedRecord | None = None
    provenance: Annotated[dict[str, Any], Field(default_factory=dict)]

    @model_validator(mode="after")
    def _keys_of_the_version(self) -> _LightsFile:
        if self.version == 1:
            added = {_ADDED_TO_FILE} & self.model_fields_set
            for i, light in enumerate(self.lights):
                keys = _ADDED_TO_LIGHTS.keys() & light.model_fields_set
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
    records = file.lights
    near = records[0].position_mm is not None
    seen: set[str] = set()
    for record in records:
        if record.id in seen:
            raise DataError(
                f"{path}: light {record.id} is listed twice: give each light its own id"
            )
        if (record.position_mm is not None) != near:
            raise DataError(
                f"{path}: light {record.id} differs in kind from the first: give all lights a "
                "direction, or all a position_mm"
            )
        if (record.axis is None) != (records[0].axis is None):
            raise DataError(
                f"{path}: light {record.id} differs from the first: give all lights an axis, or "
                "none of them"
            )
        seen.add(record.id)
    vectors = np.array([record.position_mm or record.direction for record in records])
    axes = [record.axis for record in records if record.axis is not None]
    try:
        return Lights(
            directions=None if near else vectors,
            positions_mm=vectors if near else None,
            intensities=np.array([record.intensity for record in records]),
            axes=np.array(axes) if axes else None,
            mu=np.array([record.mu for record in records]),
            ids=tuple(record.id for record in records),
            errors=_errors(records, near=near),
            calibrated=None if file.calibrated is None else file.calibrated.value(),
        )
    except DataError as error:
        raise DataError(f"{path}: {error}") from error


def _errors(records: tuple[_Light, ...], *, near: bool) -> LightErrors:
    """Return the errors of lights: NaN, or 0 spheres, for a light without them."""

    def column(key: str, *shape: int) -> Array | None:
        rows = [getattr(record, key) for record in records]
        if all(row is None for row in rows):
            return None
        unknown = np.full(shape, np.nan)
        return np.array([unknown if row is None else row for row in rows], np.float64)

    return LightErrors(
        column("covariance_mm2", 3, 3) if near else column("covariance_rad2", 2, 2),
        column("intensity_std", 3),
        column("axis_std_deg"),
        column("mu_std"),
        column("residual_px"),
        np.array([record.spheres or 0 for record in records]),
    )


def lights_json(lights: Lights, provenance: dict[str, Any]) -> str:
    """Return the text of a lights.json: version 1 if this version can hold the lights, else 2."""
    key = "direction" if lights.positions_mm is None else "position_mm"
    vectors = lights.directions if lights.positions_mm is None else lights.positions_mm
    columns = {
        key: vectors,
        "intensity": lights.intensities,
        **({"axis": lights.axes, "mu": lights.mu} if lights.near else {}),
    }
    lists = {name: np.asarray(array).tolist() for name, array in columns.items()}
    rows = [
        json.dumps(
            {"id": light} | {name: values[i] for name, values in lists.items()} | _added(lights, i)
        )
        for i, light in enumerate(lights.ids)
    ]
    version = 1 if lights.errors is None and lights.calibrated is None else 2
    calibrated = ""
    if lights.calibrated is not None:
        calibrated = f' "calibrated": {CalibratedRecord.of(lights.calibrated).json_text()},\n'
    return (
        f'{{\n "format": "sgp-lights",\n "version": {version},\n "lights": [\n  '
        + ",\n  ".join(rows)
        + f'\n ],\n{calibrated} "provenance": {json.dumps(provenance, allow_nan=False)}\n}}\n'
    )


def _added(lights: Lights, index: int) -> dict[str, Any]:
    """Return the known errors of a light by their keys."""
    if lights.errors is None:
        return {}
    left_out = "covariance_rad2" if lights.near else "covariance_mm2"
    columns = {
        key: getattr(lights.errors, name)
        for key, name in _ADDED_TO_LIGHTS.items()
        if key != left_out
    }
    values = {key: array[index] for key, array in columns.items() if array is not None}
    return {
        key: value.tolist()
        for key, value in values.items()
        if not (value == 0 if key == "spheres" else np.isnan(value).any())
    }
