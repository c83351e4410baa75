"""``session.toml``: description of a session, written once before its first frame."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from math import isqrt
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import AwareDatetime, Field, JsonValue, model_validator

from acquisition._errors import DataError, named
from acquisition.files.software import SOFTWARE, software_version
from acquisition.files.text_files import parse_toml, validated
from acquisition.plan.plan import CapturePlan
from acquisition.session.lights_record import LightColumns, LightsRecord
from acquisition.session.value_records import (
    CameraModelRecord,
    SensorRecord,
    Size,
    Table,
    TransferRecord,
    Vector,
)
from acquisition.values.camera_model import CameraModel
from acquisition.values.lights import Lights
from acquisition.values.noise_model import NoiseModel
from rig import Mounting
from rig.host import clock

FORMAT_VERSION: Final = 6
_READ: Final = (1, 2, 3, 4, 5, FORMAT_VERSION)
# Versions that this program can write: a session of an older version keeps its version.
_WRITTEN: Final = (2, 3, 4, 5, FORMAT_VERSION)
# Keys that a version added, by table; "" is the file itself. Version 4 also has another form of the
# lights.
_ADDED: Final[dict[int, dict[str, tuple[str, ...]]]] = {
    2: {
        "plan": (
            "exposures_by_led",
            "flats",
            "max_clipped_fraction",
            "retakes",
            "sequence",
        ),
        "rig": ("dead_leds", "mounting", "options", "trigger"),
    },
    3: {"": ("transfer",)},
    4: {
        "": ("origin", "echoes"),
        "rig": ("led_positions_mm", "led_positions_sigma_mm"),
        "camera": ("black_levels_dn",),
    },
    5: {"plan": ("repeat",)},
    6: {"plan": ("repeat_every",)},
}

# Devices and driver of the simulator, by the names that they report.
_SIMULATED_DRIVER: Final = "simulated"
_SIMULATED_BOARD: Final = "sgp-virtual-board"
_SIMULATED_CAMERA: Final = ("sgp", "virtual camera")

_Index = Annotated[int, Field(ge=0)]


class SoftwareRecord(Table):
    """The program that wrote the session."""

    name: str = SOFTWARE
    version: str = Field(default_factory=software_version)


class RigRecord(Table):
    """The rig: name and driver of the rig file, and the identity that its board reported.

    ``mounting`` is the camera's mounting if its frames are not upright, ``dead_leds`` are the dead
    LEDs of the rig file, and ``trigger`` is the device that starts an exposure. ``options`` are the
    options of the rig file that configure camera and board; those that locate them are left out.
    ``led_positions_mm`` are the positions of all LEDs with their standard deviation, if known.
    """

    name: str
    driver: str
    board: str
    protocol: str
    firmware: str
    leds: Size
    mounting: Mounting | None = None
    dead_leds: tuple[_Index, ...] = ()
    trigger: Literal["software", "board"] = "software"
    options: dict[str, JsonValue] | None = None
    led_positions_mm: tuple[Vector, ...] | None = None
    led_positions_sigma_mm: Annotated[float, Field(gt=0)] | None = None

    @property
    def simulated(self) -> bool:
        """Whether this is the simulated rig, or a rig with the virtual board."""
        return self.driver == _SIMULATED_DRIVER or self.board == _SIMULATED_BOARD


class CameraRecord(Table):
    """The camera as a device, and the frames it delivers.

    ``bit_depth`` is the number of significant low bits of each 16-bit sample. ``cfa`` names the
    colours of the filter mosaic from the top left, row by row; absent for grey and RGB.
    ``channels`` is 1 (grey or mosaic) or 3 (RGB). Default levels: black 0, white
    ``2 ** bit_depth - 1``. ``black_levels_dn`` are those of the positions of a square block that
    repeats, row by row; absent if they are equal.
    """

    width: Size
    height: Size
    channels: Literal[1, 3] = 1
    bit_depth: Annotated[int, Field(ge=8, le=16)]
    pixel_format: str = ""
    cfa: Annotated[str, Field(pattern=r"^[A-Z]+$")] | None = None
    vendor: str = ""
    model: str = ""
    serial: str = ""
    black_level_dn: Annotated[float, Field(ge=0)] = 0.0
    white_level_dn: Annotated[float, Field(gt=0, le=65535)] | None = None
    black_levels_dn: tuple[Annotated[float, Field(ge=0)], ...] | None = None

    @property
    def white_dn(self) -> float:
        """Grey value from which a sample counts as saturated."""
        if self.white_level_dn is not None:
            return self.white_level_dn
        return float(2**self.bit_depth - 1)

    @property
    def simulated(self) -> bool:
        """Whether this is a virtual camera."""
        vendor, model = _SIMULATED_CAMERA
        return self.vendor == vendor and self.model.startswith(model)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of every frame as an array, ``(H, W)`` or ``(H, W, 3)``."""
        size = (self.height, self.width)
        return size if self.channels == 1 else (*size, 3)

    @property
    def frame_bytes(self) -> int:
        """Bytes of the uncompressed samples of a frame."""
        return 2 * self.width * self.height * self.channels

    @model_validator(mode="after")
    def _possible(self) -> CameraRecord:
        if self.frame_bytes >= 2**32:
            raise ValueError(
                f"frames of {self.width} x {self.height} pixels exceed the 4 GiB of a TIFF file"
            )
        if self.black_level_dn >= self.white_dn:
            raise ValueError("the black level is not below the white level")
        levels = self.black_levels_dn or (self.black_level_dn,)
        if isqrt(len(levels)) ** 2 != len(levels) or max(levels) >= self.white_dn:
            raise ValueError("the black levels are not a square block below the white level")
        return self


class _OldLights(Table):
    lights: LightColumns


@dataclass(frozen=True)
class Labels:
    """Texts that describe a recording for people; a program reads none of them.

    Parameters
    ----------
    operator
        Name of the operator.
    object_name
        Name of the object.
    place
        Place of the recording.
    notes
        Free text.
    rights
        Holder of the rights, and the licence.
    """

    operator: str = ""
    object_name: str = ""
    place: str = ""
    notes: str = ""
    rights: str = ""


@dataclass(frozen=True, eq=False)
class Calibrations:
    """Calibrations to store with a recording, each of them if known.

    Parameters
    ----------
    camera_model
        Model of the upright image, however the camera is mounted.
    sensor
        Noise of the sensor. It defines black and white level; without it black is 0 and white is
        the maximum of the camera's bit depth.
    lights
        Lights, matched with the LEDs by their ids, ``L07`` for LED 7. There may be more lights than
        LEDs.
    """

    camera_model: CameraModel | None = None
    sensor: NoiseModel | None = None
    lights: Lights | None = None


class Manifest(Table):
    """Content of ``session.toml``.

    Sessions of earlier versions have default values for keys that were added. ``format_version``
    is the version with which the session was created; see `Session.format_version`. ``plan`` and
    ``rig`` are absent in imported sessions. ``camera`` describes the device and its frames as
    stored; ``camera_model``, ``sensor`` and ``lights`` are calibrations, present if known. The
    camera model describes the upright image. ``origin`` is that of an imported recording whose
    devices the session does not name. ``echoes`` states that the board of the rig confirms the
    light of every frame. ``transfer`` is the transfer curve of the frames; a
    session without it is linear.
    """

    format_version: Literal[1, 2, 3, 4, 5, 6] = FORMAT_VERSION
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
    origin: Literal["simulated"] | None = None
    echoes: Literal[True] | None = None
    transfer: TransferRecord | None = None
    camera_model: CameraModelRecord | None = None
    sensor: SensorRecord | None = None
    lights: LightsRecord | None = None

    def __repr__(self) -> str:
        started = f"{self.started_utc:%Y-%m-%d %H:%M} UTC"
        return f"Manifest({self.object or 'no object'}, {started}, format {self.format_version})"

    @property
    def mounting(self) -> Mounting:
        """Mounting of the camera, from which stored frames are turned upright; default none."""
        mounting = None if self.rig is None else self.rig.mounting
        return mounting or Mounting()

    @property
    def simulated(self) -> bool:
        """Whether rig or camera are simulated, by the names that they reported or by `origin`."""
        devices = self.camera.simulated or (self.rig is not None and self.rig.simulated)
        return devices or self.origin == "simulated"

    def planned(self, asked: CapturePlan) -> CapturePlan:
        """Return a requested plan as a session with this rig and format would have stored it.

        Raises
        ------
        DataError
            If every LED of the plan is dead.
        """
        if self.rig is not None:
            asked, _ = asked.without(self.rig.dead_leds)
        if self.format_version < 6:
            asked = asked.changed(repeat_every=0, repeat=asked.repeat and self.format_version > 4)
        return asked

    def check_current(self, folder: Path) -> None:
        """Refuse to continue a session of a format version that this program does not write.

        Raises
        ------
        DataError
            If it has another version; the message names ``folder``.
        """
        if self.format_version not in _WRITTEN:
            raise DataError(
                f"{folder}: has format version {self.format_version}, this program writes "
                f"{_listed(_WRITTEN)}: finish it with the program that started it "
                f"({self.software.name} {self.software.version}), or record again"
            )

    @classmethod
    def begin(
        cls,
        folder: str | Path,
        *,
        camera: dict[str, Any],
        labels: Labels = Labels(),
        calibrations: Calibrations = Calibrations(),
        **others: Any,
    ) -> Manifest:
        """Return the manifest of a session that starts now.

        Parameters
        ----------
        folder
            Folder of the session, for the message.
        camera
            Fields of `CameraRecord`.
        labels, calibrations
            Texts and calibrations to store.
        others
            The remaining fields.

        Raises
        ------
        DataError
            If a value is invalid for its field; the message names ``folder`` and the field.
        """
        model, sensor = calibrations.camera_model, calibrations.sensor
        lights = calibrations.lights
        texts = asdict(labels)
        values = {
            "started_utc": clock.utc_now(),
            "object": texts.pop("object_name"),
            **texts,
            "camera": camera,
            "echoes": None if others.get("rig") is None else True,
            "camera_model": None if model is None else CameraModelRecord.of(model),
            "sensor": None if sensor is None else SensorRecord.of(sensor),
            "lights": None if lights is None else LightsRecord.of(lights),
            **others,
        }
        return validated(cls, values, Path(folder))


def parse_manifest(data: bytes, path: Path) -> Manifest:
    """Parse ``session.toml``.

    Raises
    ------
    DataError
        If it is not TOML, has another format version, or contains an unknown key or an invalid
        value; the message names ``path``.
    """
    values = parse_toml(data, path)
    version = values.get("format_version")
    if type(version) is not int or version not in _READ:
        raise DataError(
            f"{path}: format version {version!r} is unknown, this program reads "
            f"{_listed(_READ)}; use the version that wrote it"
        )
    for since, tables in _ADDED.items():
        if version < since:
            _refuse_added(values, path, tables)
    if version < 5 and isinstance(values.get("plan"), dict):
        values["plan"] = {**values["plan"], "repeat": False}
    if version < 4 and "lights" in values:
        columns = validated(_OldLights, {"lights": values["lights"]}, path).lights
        with named(path):
            values["lights"] = LightsRecord.of(columns.value())
    manifest = validated(Manifest, values, path)
    with named(path):
        for record in (manifest.camera_model, manifest.sensor, manifest.lights):
            if record is not None:
                record.value()
    return manifest


def _listed(versions: tuple[int, ...]) -> str:
    return f"{', '.join(map(str, versions[:-1]))} and {versions[-1]}"


def _refuse_added(
    values: dict[str, Any], path: Path, added_keys: dict[str, tuple[str, ...]]
) -> None:
    """Refuse keys by table that a session of this version cannot have."""
    version = values["format_version"]
    for table, keys in added_keys.items():
        entries = values.get(table) if table else values
        added = [key for key in keys if isinstance(entries, dict) and key in entries]
        if added:
            key = f"{table}.{added[0]}".lstrip(".")
            raise DataError(
                f"{path}: unknown key '{key}': format version {version} does not have it"
            )
