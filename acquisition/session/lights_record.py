"""Lights as they are stored, in ``lights.json`` and in ``session.toml``."""

from __future__ import annotations

from typing import Annotated, Any, Final

import numpy as np
from pydantic import Field, model_validator

from acquisition._errors import DataError
from acquisition.session.value_records import CalibratedRecord, Table, Vector
from acquisition.values.light_errors import LightErrors
from acquisition.values.lights import Lights
from rig.arrays import Float64

_Deviation = Annotated[float, Field(ge=0)]

# Keys of a light that hold its errors, with their fields of `LightErrors`.
ERROR_KEYS: Final = {
    "covariance_mm2": "covariances",
    "covariance_rad2": "covariances",
    "intensity_std": "intensity_std",
    "axis_std_deg": "axis_std_deg",
    "mu_std": "mu_std",
    "residual_px": "residual_px",
    "spheres": "spheres",
}
_OF_THE_OTHER_KIND: Final = {
    "direction": ("covariance_mm2", "axis_std_deg", "mu_std"),
    "position": ("covariance_rad2",),
}


class LightRecord(Table):
    """One light; errors that are not known are absent."""

    id: str
    direction: Vector | None = None
    position_mm: Vector | None = None
    intensity: Vector = (1.0, 1.0, 1.0)
    axis: Vector | None = None
    mu: Annotated[float, Field(ge=0)] | None = None
    covariance_mm2: tuple[Vector, Vector, Vector] | None = None
    covariance_rad2: tuple[tuple[float, float], tuple[float, float]] | None = None
    intensity_std: tuple[_Deviation, _Deviation, _Deviation] | None = None
    axis_std_deg: _Deviation | None = None
    mu_std: _Deviation | None = None
    residual_px: _Deviation | None = None
    spheres: Annotated[int, Field(ge=1)] | None = None

    @model_validator(mode="after")
    def _one_vector(self) -> LightRecord:
        if (self.direction is None) == (self.position_mm is None):
            raise ValueError("a light needs either direction or position_mm")
        kind = "direction" if self.position_mm is None else "position"
        for key in _OF_THE_OTHER_KIND[kind]:
            if getattr(self, key) is not None:
                raise ValueError(f"a light with a {kind} has no {key}")
        return self


class LightsRecord(Table):
    """All data of `Lights`: one record per light, and the origin of the calibration."""

    lights: Annotated[tuple[LightRecord, ...], Field(min_length=1)]
    calibrated: CalibratedRecord | None = None

    @classmethod
    def of(cls, lights: Lights) -> LightsRecord:
        """Return the record of lights."""
        key = "direction" if lights.positions_mm is None else "position_mm"
        vectors = lights.directions if lights.positions_mm is None else lights.positions_mm
        columns = {
            key: vectors,
            "intensity": lights.intensities,
            **({"axis": lights.axes, "mu": lights.mu} if lights.near else {}),
        }
        lists = {name: np.asarray(array).tolist() for name, array in columns.items()}
        rows = [
            LightRecord(id=light, **{name: values[i] for name, values in lists.items()}, **errors)
            for i, (light, errors) in enumerate(zip(lights.ids, _errors_of(lights), strict=True))
        ]
        calibrated = lights.calibrated
        return cls(
            lights=tuple(rows),
            calibrated=None if calibrated is None else CalibratedRecord.of(calibrated),
        )

    def value(self) -> Lights:
        """Return the lights; raise DataError if the values are invalid, with the light named."""
        records = self.lights
        near = records[0].position_mm is not None
        seen: set[str] = set()
        for record in records:
            if record.id in seen:
                raise DataError(f"light {record.id} is listed twice: give each light its own id")
            if (record.position_mm is not None) != near:
                raise DataError(
                    f"light {record.id} differs in kind from the first: give all lights a "
                    "direction, or all a position_mm"
                )
            if (record.axis is None) != (records[0].axis is None):
                raise DataError(
                    f"light {record.id} differs from the first: give all lights an axis, or none "
                    "of them"
                )
            seen.add(record.id)
        vectors = np.array([record.position_mm or record.direction for record in records])
        axes = [record.axis for record in records if record.axis is not None]
        return Lights(
            directions=None if near else vectors,
            positions_mm=vectors if near else None,
            intensities=np.array([record.intensity for record in records]),
            axes=np.array(axes) if axes else None,
            mu=np.array([record.mu or 0.0 for record in records]),
            ids=tuple(record.id for record in records),
            errors=_errors(records, near=near),
            calibrated=None if self.calibrated is None else self.calibrated.value(),
        )


class LightColumns(Table):
    """Lights of sessions up to version 3: one list per value, without errors."""

    ids: tuple[str, ...]
    directions: tuple[Vector, ...] | None = None
    positions_mm: tuple[Vector, ...] | None = None
    intensities: tuple[Vector, ...]
    axes: tuple[Vector, ...]
    mu: tuple[float, ...]

    def value(self) -> Lights:
        """Return the lights; raise DataError if the values are invalid."""
        return Lights(
            None if self.directions is None else np.array(self.directions),
            None if self.positions_mm is None else np.array(self.positions_mm),
            np.array(self.intensities),
            np.array(self.axes),
            np.array(self.mu),
            self.ids,
        )


def _errors(records: tuple[LightRecord, ...], *, near: bool) -> LightErrors:
    """Return the errors of lights: NaN, or 0 spheres, for a light without them."""

    def column(key: str) -> Float64 | None:
        rows = [getattr(record, key) for record in records]
        known = next((row for row in rows if row is not None), None)
        if known is None:
            return None
        unknown = np.full(np.shape(known), np.nan)
        return np.array([unknown if row is None else row for row in rows], np.float64)

    keys = ERROR_KEYS.keys() - {"spheres", "covariance_rad2" if near else "covariance_mm2"}
    return LightErrors(
        **{ERROR_KEYS[key]: column(key) for key in keys},
        spheres=np.array([record.spheres or 0 for record in records]),
    )


def _errors_of(lights: Lights) -> list[dict[str, Any]]:
    """Return the known errors of each light by their keys."""
    if lights.errors is None:
        return [{} for _ in lights.ids]
    left_out = "covariance_rad2" if lights.near else "covariance_mm2"
    columns = {
        key: getattr(lights.errors, name) for key, name in ERROR_KEYS.items() if key != left_out
    }
    known = {key: array for key, array in columns.items() if array is not None}
    return [
        {
            key: array[i].tolist()
            for key, array in known.items()
            if not (array[i] == 0 if key == "spheres" else np.isnan(array[i]).any())
        }
        for i in range(len(lights))
    ]
