"""Calibrated values in ``session.toml``: sensor, transfer curve and camera model."""

from __future__ import annotations

from dataclasses import fields
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from acquisition._values.camera_model import CameraModel
from acquisition._values.noise_model import NoiseModel
from acquisition._values.transfer_curve import TransferCurve

Size = Annotated[int, Field(ge=1, lt=2**31)]
Vector = tuple[float, float, float]


class Table(BaseModel):
    """A table of ``session.toml``: unknown keys, NaN and infinities are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class SensorRecord(Table):
    """Fields of a `NoiseModel`; omitted fields have the model's default."""

    electrons_per_dn: float
    read_noise_e: float
    black_level_dn: float
    bit_depth: Annotated[int, Field(ge=8, le=16)]
    quantum_efficiency: float | None = None
    full_well_e: float | None = None
    dark_current_e_per_s: float | None = None
    dsnu_e: float | None = None
    prnu: float | None = None
    hot_pixel_fraction: float | None = None
    hot_pixel_e_per_s: float | None = None

    @classmethod
    def of(cls, sensor: NoiseModel) -> SensorRecord:
        """Return the record of a noise model."""
        values = {item.name: (getattr(sensor, item.name), item.default) for item in fields(sensor)}
        return cls.model_validate(
            {name: value for name, (value, default) in values.items() if value != default}
        )

    def value(self) -> NoiseModel:
        """Return the noise model; raise DataError if the values are invalid."""
        return NoiseModel(**self.model_dump(exclude_none=True))


class TransferRecord(Table):
    """Fields of a `TransferCurve`; those of other kinds are omitted."""

    kind: Literal["linear", "srgb", "power", "table"]
    exponent: float | None = None
    points: tuple[tuple[float, float], ...] | None = None

    @classmethod
    def of(cls, curve: TransferCurve) -> TransferRecord:
        """Return the record of a transfer curve."""
        return cls(kind=curve.kind, exponent=curve.exponent, points=curve.points or None)

    def value(self) -> TransferCurve:
        """Return the curve; raise DataError if the values are invalid."""
        return TransferCurve(self.kind, self.exponent, self.points or ())

    @model_validator(mode="after")
    def _valid(self) -> TransferRecord:
        self.value()
        return self


class CameraModelRecord(Table):
    """Fields of a `CameraModel`."""

    K: tuple[Vector, Vector, Vector]
    distortion: tuple[float, ...]
    width: Size
    height: Size
    working_distance_mm: float | None = None
    lens: str | None = None
    focus_mm: float | None = None

    @classmethod
    def of(cls, camera: CameraModel) -> CameraModelRecord:
        """Return the record of a camera model."""
        return cls(
            K=camera.K.tolist(),
            distortion=camera.distortion.tolist(),
            width=camera.width,
            height=camera.height,
            working_distance_mm=camera.working_distance_mm,
            lens=camera.lens or None,
            focus_mm=camera.focus_mm,
        )

    def value(self) -> CameraModel:
        """Return the camera model; raise DataError if the values are invalid."""
        return CameraModel(
            np.array(self.K),
            self.width,
            self.height,
            self.working_distance_mm,
            np.array(self.distortion),
            self.lens or "",
            self.focus_mm,
        )
