"""Calibrated values as they are stored in ``session.toml`` and in files of their own."""

from __future__ import annotations

import json
from dataclasses import asdict, fields
from typing import Annotated, Literal

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, model_validator

from acquisition.values.camera_model import CameraModel
from acquisition.values.noise_model import NoiseModel
from acquisition.values.setup import Calibrated, Setup, UsedSphere
from acquisition.values.transfer_curve import TransferCurve

Size = Annotated[int, Field(ge=1, lt=2**31)]
Vector = tuple[float, float, float]
_Positive = Annotated[float, Field(gt=0)]


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
        values = {name: getattr(camera, name) for name in CameraModelRecord.model_fields}
        arrays = {"K": camera.K.tolist(), "distortion": camera.distortion.tolist()}
        return cls.model_validate({**values, **arrays, "lens": camera.lens or None})

    def value(self) -> CameraModel:
        """Return the camera model; raise DataError if the values are invalid."""
        names = set(CameraModelRecord.model_fields)
        return CameraModel(**self.model_dump(include=names, exclude_none=True))


class CameraNames(Table):
    """The names of the camera in a `Setup`; empty texts are not known."""

    vendor: str = ""
    model: str = ""
    serial: str = ""

    @classmethod
    def of(cls, setup: Setup) -> CameraNames:
        """Return the names of a value."""
        return cls(vendor=setup.camera_vendor, model=setup.camera_model, serial=setup.camera_serial)

    def value(self, rig: str = "", intrinsics: CameraModel | None = None) -> Setup:
        """Return the value with the name of a rig and the lens."""
        return Setup(rig, self.vendor, self.model, self.serial, intrinsics)


class _Sphere(Table):
    centre_px: tuple[float, float]
    radius_px: _Positive
    centre_mm: tuple[float, float, float] | None = None
    radius_mm: _Positive | None = None
    recording: str = ""


class CalibratedRecord(Table):
    """Fields of `Calibrated` and its `Setup`; what is not known is absent."""

    time_utc: AwareDatetime | None = None
    rig: str = ""
    camera: CameraNames | None = None
    intrinsics: CameraModelRecord | None = None
    spheres: tuple[_Sphere, ...] = ()

    @classmethod
    def of(cls, calibrated: Calibrated) -> CalibratedRecord:
        """Return the record of a value."""
        setup, names = calibrated.setup, CameraNames.of(calibrated.setup)
        return cls(
            time_utc=calibrated.time_utc,
            rig=setup.rig,
            camera=None if names == CameraNames() else names,
            intrinsics=None if setup.intrinsics is None else CameraModelRecord.of(setup.intrinsics),
            spheres=tuple(_Sphere(**asdict(sphere)) for sphere in calibrated.spheres),
        )

    def value(self) -> Calibrated:
        """Return the value; raise DataError if it is invalid."""
        intrinsics = None if self.intrinsics is None else self.intrinsics.value()
        return Calibrated(
            self.time_utc,
            (self.camera or CameraNames()).value(self.rig, intrinsics),
            tuple(UsedSphere(**sphere.model_dump()) for sphere in self.spheres),
        )

    def json_text(self) -> str:
        """Return the record as JSON in one line, without what is not known."""
        return json.dumps(self.model_dump(mode="json", exclude_none=True, exclude_defaults=True))
