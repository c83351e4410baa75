"""lights.json: all data of `Lights`, one line per light, and their origin."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from acquisition._errors import DataError
from acquisition._json import parse_json
from acquisition._values.lights import Lights

_Vector = tuple[float, float, float]


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class _Light(_Record):
    id: str
    direction: _Vector | None = None
    position_mm: _Vector | None = None
    intensity: _Vector = (1.0, 1.0, 1.0)
    axis: _Vector | None = None
    mu: Annotated[float, Field(ge=0)] = 0.0

    @model_validator(mode="after")
    def _one_vector(self) -> _Light:
        if (self.direction is None) == (self.position_mm is None):
            raise ValueError("a light needs either direction or position_mm")
        return self


class _LightsFile(_Record):
    format: Literal["sgp-lights"]
    version: Literal[1]
    lights: Annotated[tuple[_Light, ...], Field(min_length=1)]
    provenance: dict[str, Any] = {}


def parse_lights_json(text: str, path: Path) -> Lights:
    """Build lights from the text of a lights.json.

    Raises
    ------
    DataError
        If the text is invalid; the message names ``path`` and the light.
    """
    records = parse_json(_LightsFile, text, path).lights
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
        )
    except DataError as error:
        raise DataError(f"{path}: {error}") from error


def lights_json(lights: Lights, provenance: dict[str, Any]) -> str:
    """Return the text of a lights.json."""
    key = "direction" if lights.positions_mm is None else "position_mm"
    vectors = lights.directions if lights.positions_mm is None else lights.positions_mm
    columns = {
        key: vectors,
        "intensity": lights.intensities,
        **({"axis": lights.axes, "mu": lights.mu} if lights.near else {}),
    }
    lists = {name: np.asarray(array).tolist() for name, array in columns.items()}
    rows = [
        json.dumps({"id": light} | {name: values[i] for name, values in lists.items()})
        for i, light in enumerate(lights.ids)
    ]
    return (
        '{\n "format": "sgp-lights",\n "version": 1,\n "lights": [\n  '
        + ",\n  ".join(rows)
        + f'\n ],\n "provenance": {json.dumps(provenance, allow_nan=False)}\n}}\n'
    )
