"""``session.toml``: what a session is, written once before its first frame."""

from __future__ import annotations

from dataclasses import fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, JsonValue, model_validator

from acquisition._errors import DataError
from acquisition._plan.plan import CapturePlan
from acquisition._software import SOFTWARE, software_version
from acquisition._toml import parse_toml, validated
from acquisition._values.camera_model import CameraModel
from acquisition._values.lights import Lights
from acquisition._values.noise_model import NoiseModel
from rig import Mounting

FORMAT_VERSION: Final = 2
_READ: Final = (1, FORMAT_VERSION)
# What version 2 has more than version 1, by table.
_ADDED: Final = {
    "plan": (
        "exposures_by_led",
        "flats",
        "max_clipped_fraction",
        "retakes",
        "sequence",
    ),
    "rig": ("dead_leds", "mounting", "options", "trigger"),
}

_Size = Annotated[int, Field(ge=1)]
_Index = Annotated[int, Field(ge=0)]
_Vector = tuple[float, float, float]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class SoftwareRecord(_Table):
    """The program that wrote the session."""

    name: str = SOFTWARE
    version: str = Field(default_factory=software_version)


class RigRecord(_Table):
    """The rig: name and driver of the rig file, and how its board identified itself.

    ``mounting`` is how the camera was mounted, where its frames do not stand upright; ``dead_leds``
    are those that the rig file lists, ``trigger`` is who starts an exposure. ``options`` are those
    of the rig file that say how, not where, the driver finds and sets camera and board.
    """

    name: str
    driver: str
    board: str
    protocol: str
    firmware: str
    leds: _Size
    mounting: Mounting | None = None
    dead_leds: tuple[_Index, ...] = ()
    trigger: Literal["software", "board"] = "software"
    options: dict[str, JsonValue] | None = None


class CameraRecord(_Table):
    """The camera as a device, and the frames it delivers.

    ``bit_depth`` counts the significant low bits of each 16-bit sample. ``cfa`` names the colours
    of the filter mosaic from the top left, row by row; absent for grey and RGB. ``channels`` is 1
    (grey or mosaic) or 3 (RGB). Absent levels: black 0, white ``2 ** bit_depth - 1``.
    """

    width: _Size
    height: _Size
    channels: Literal[1, 3] = 1
    bit_depth: Annotated[int, Field(ge=8, le=16)]
    pixel_format: str = ""
    cfa: Annotated[str, Field(pattern=r"^[A-Z]+$")] | None = None
    vendor: str = ""
    model: str = ""
    serial: str = ""
    black_level_dn: Annotated[float, Field(ge=0)] = 0.0
    white_level_dn: Annotated[float, Field(gt=0, le=65535)] | None = None

    @property
    def white_dn(self) -> float:
        """Grey value from which a sample counts as saturated."""
        if self.white_level_dn is not None:
            return self.white_level_dn
        return float(2**self.bit_depth - 1)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of every frame as an array, ``(H, W)`` or ``(H, W, 3)``."""
        size = (self.height, self.width)
        return size if self.channels == 1 else (*size, 3)

    @model_validator(mode="after")
    def _ordered_levels(self) -> CameraRecord:
        if self.black_level_dn >= self.white_dn:
            raise ValueError("the black level is not below the white level")
        return self


class SensorRecord(_Table):
    """A `NoiseModel`, written out; what is left out has the model's default."""

    electrons_per_dn: float
    read_noise_e: float
    black_level_dn: float
    bit_depth: int
    quantum_efficiency: float | None = None
    full_well_e: float | None = None
    dark_current_e_per_s: float | None = None
    dsnu_e: float | None = None
    prnu: float | None = None
    hot_pixel_fraction: float | None = None
    hot_pixel_e_per_s: float | None = None

    @classmethod
    def of(cls, sensor: NoiseModel) -> SensorRecord:
        """Write out a sensor."""
        values = {item.name: (getattr(sensor, item.name), item.default) for item in fields(sensor)}
        return cls.model_validate(
            {name: value for name, (value, default) in values.items() if value != default}
        )

    def value(self) -> NoiseModel:
        """Return the sensor; raises DataError where the numbers make none."""
        return NoiseModel(**self.model_dump(exclude_none=True))


class CameraModelRecord(_Table):
    """A `CameraModel`, written out."""

    K: tuple[_Vector, _Vector, _Vector]
    distortion: tuple[float, ...]
    width: _Size
    height: _Size
    working_distance_mm: float | None = None

    @classmethod
    def of(cls, camera: CameraModel) -> CameraModelRecord:
        """Write out a camera model."""
        return cls(
            K=camera.K.tolist(),
            distortion=camera.distortion.tolist(),
            width=camera.width,
            height=camera.height,
            working_distance_mm=camera.working_distance_mm,
        )

    def value(self) -> CameraModel:
        """Return the camera model; raises DataError where the numbers make none."""
        return CameraModel(
            np.array(self.K),
            self.width,
            self.height,
            self.working_distance_mm,
            np.array(self.distortion),
        )


class LightsRecord(_Table):
    """`Lights`, written out: one row per light, either directions or positions."""

    ids: tuple[str, ...]
    directions: tuple[_Vector, ...] | None = None
    positions_mm: tuple[_Vector, ...] | None = None
    intensities: tuple[_Vector, ...]
    axes: tuple[_Vector, ...]
    mu: tuple[float, ...]

    @classmethod
    def of(cls, lights: Lights) -> LightsRecord:
        """Write out lights."""
        columns = ("directions", "positions_mm", "intensities", "axes", "mu")
        arrays = {name: getattr(lights, name) for name in columns}
        rows = {name: array.tolist() for name, array in arrays.items() if array is not None}
        return cls(ids=lights.ids, **rows)

    def value(self) -> Lights:
        """Return the lights; raises DataError where the numbers make none."""
        columns = self.model_dump(exclude={"ids"}, exclude_none=True)
        return Lights(ids=self.ids, **{name: np.array(rows) for name, rows in columns.items()})


class Manifest(_Table):
    """What ``session.toml`` holds.

    Sessions of version 1 have the defaults of what version 2 added.
    ``plan`` and ``rig`` are absent in imported sessions. ``camera`` is the device and its frames as
    stored; ``camera_model``, ``sensor`` and ``lights`` are calibrations, present where known, and
    the camera model is that of the upright image.
    """

    format_version: Literal[1, 2] = FORMAT_VERSION
    started_utc: AwareDatetime
    operator: str
    object: str
    place: str = ""
    notes: str = ""
    rights: str = ""
    software: SoftwareRecord = Field(default_factory=SoftwareRecord)
    plan: CapturePlan | None = None
    rig: RigRecord | None = None
    camera: CameraRecord
    camera_model: CameraModelRecord | None = None
    sensor: SensorRecord | None = None
    lights: LightsRecord | None = None

    @property
    def mounting(self) -> Mounting:
        """What has to be done to a stored frame until it stands upright; nothing, where unknown."""
        mounting = None if self.rig is None else self.rig.mounting
        return mounting or Mounting()

    def check_current(self, folder: Path) -> None:
        """Refuse to go on with a session of another format version: no file mixes versions.

        Raises
        ------
        DataError
            If it is of another version; the message names ``folder``.
        """
        if self.format_version != FORMAT_VERSION:
            raise DataError(
                f"{folder}: was begun in format version {self.format_version}, this program writes "
                f"{FORMAT_VERSION}: finish it with the program that began it (surface-geometry-"
                f"processing {self.software.version}), or record anew"
            )

    @classmethod
    def begin(
        cls,
        folder: str | Path,
        *,
        camera: dict[str, Any],
        camera_model: CameraModel | None = None,
        sensor: NoiseModel | None = None,
        lights: Lights | None = None,
        **others: Any,
    ) -> Manifest:
        """Describe a session that begins now.

        Parameters
        ----------
        folder
            Of the session, for the message.
        camera
            Fields of `CameraRecord`.
        camera_model, sensor, lights
            Calibrations to store, where known.
        others
            The remaining fields.

        Raises
        ------
        DataError
            If a value is not what the field takes; the message names ``folder`` and the field.
        """
        values = {
            "started_utc": datetime.now(UTC),
            "camera": camera,
            "camera_model": None if camera_model is None else CameraModelRecord.of(camera_model),
            "sensor": None if sensor is None else SensorRecord.of(sensor),
            "lights": None if lights is None else LightsRecord.of(lights),
            **others,
        }
        return validated(cls, values, Path(folder))


def parse_manifest(data: bytes, path: Path) -> Manifest:
    """Read ``session.toml``.

    Raises
    ------
    DataError
        If it is not TOML, of another format version, or holds a key or value that is not
        understood; the message names ``path``.
    """
    values = parse_toml(data, path)
    version = values.get("format_version")
    if type(version) is not int or version not in _READ:
        raise DataError(
            f"{path}: format version {version!r} is not understood, this program reads "
            f"{' and '.join(map(str, _READ))}; use the version that wrote it"
        )
    if version < FORMAT_VERSION:
        _refuse_added(values, path)
    manifest = validated(Manifest, values, path)
    try:
        for record in (manifest.camera_model, manifest.sensor, manifest.lights):
            if record is not None:
                record.value()
    except DataError as error:
        raise DataError(f"{path}: {error}") from error
    return manifest


def _refuse_added(values: dict[str, Any], path: Path) -> None:
    """Refuse keys that a session of version 1 cannot have."""
    for table, keys in _ADDED.items():
        found = values.get(table)
        added = [key for key in keys if isinstance(found, dict) and key in found]
        if added:
            raise DataError(
                f"{path}: unknown key '{table}.{added[0]}': format version 1 has none of that name"
            )
