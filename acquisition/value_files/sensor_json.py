"""sensor.json: figures of a sensor with standard deviations, and their origin."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AwareDatetime, Field

from acquisition._errors import DataError, named
from acquisition.files.storage import write_durably
from acquisition.files.text_files import parse_versioned, read_text
from acquisition.session.value_records import CameraNames, Table
from acquisition.values.measured_sensor import Measured, MeasuredSensor

_Sigma = Annotated[float, Field(ge=0)]


class _Figures(Table):
    electrons_per_dn: Annotated[float, Field(gt=0)]
    electrons_per_dn_sigma: _Sigma
    read_noise_e: Annotated[float, Field(ge=0)]
    read_noise_e_sigma: _Sigma
    black_level_dn: float
    black_level_dn_sigma: _Sigma
    dsnu_e: Annotated[float, Field(ge=0)]
    dsnu_e_sigma: _Sigma
    prnu: Annotated[float, Field(ge=0)]
    prnu_sigma: _Sigma
    linearity_error: Annotated[float, Field(ge=0)]
    linearity_error_sigma: _Sigma
    dark_current_e_per_s: float | None = None
    dark_current_e_per_s_sigma: _Sigma | None = None
    full_well_e: Annotated[float, Field(gt=0)] | None = None
    full_well_e_sigma: _Sigma | None = None
    saturation_capacity_e: Annotated[float, Field(gt=0)] | None = None
    saturation_capacity_e_sigma: _Sigma | None = None
    snr_max: Annotated[float, Field(gt=0)] | None = None
    snr_max_sigma: _Sigma | None = None
    dynamic_range: Annotated[float, Field(gt=0)] | None = None
    dynamic_range_sigma: _Sigma | None = None


class _SensorFile(Table):
    format: Literal["sgp-sensor"]
    version: Literal[1]
    time_utc: AwareDatetime | None = None
    camera: CameraNames = CameraNames()
    bit_depth: Annotated[int, Field(ge=8, le=16)]
    gain_db: float
    figures: _Figures
    full_well_limit: Literal["converter", "pixel"] | None = None
    hot_pixel_fraction: Annotated[float, Field(ge=0, le=1)] = 0.0
    hot_pixel_e_per_s: Annotated[float, Field(ge=0)] = 0.0
    provenance: Annotated[dict[str, Any], Field(default_factory=dict)]


def read_sensor(path: str | Path) -> MeasuredSensor:
    """Read a measured sensor from a sensor.json.

    Parameters
    ----------
    path
        File that `write_sensor` wrote; docs/sensor-format.md describes it.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If it is not a sensor.json, has another version or an invalid value; the message names the
        file and the key.

    Examples
    --------
    >>> from acquisition import MeasuredSensor
    >>> from acquisition.value_files import read_sensor, write_sensor
    >>> from acquisition.values import Measured
    >>> names = ("electrons_per_dn", "read_noise_e", "black_level_dn")
    >>> known = dict(zip(names, (Measured(2.5, 0.01), Measured(3.0, 0.02), Measured(64.0, 0.1))))
    >>> still = dict.fromkeys(("dsnu_e", "prnu", "linearity_error"), Measured(0.0, 0.0))
    >>> write_sensor("sensor.json", MeasuredSensor(12, 0.0, **known, **still))
    >>> read_sensor("sensor.json").noise_model()
    NoiseModel(2.5 e/DN, read noise 3 e, black level 64 DN, 12 bit)
    """
    path = Path(path)
    text = read_text(path)
    file = parse_versioned(_SensorFile, text, path)
    figures = file.figures.model_dump()
    names = [name for name in figures if not name.endswith("_sigma")]
    for name in names:
        if (figures[name] is None) != (figures[f"{name}_sigma"] is None):
            raise DataError(f"{path}: figures.{name} needs {name}_sigma: give both or neither")
    measured: dict[str, Any] = {
        name: Measured(figures[name], figures[f"{name}_sigma"])
        for name in names
        if figures[name] is not None
    }
    with named(path):
        return MeasuredSensor(
            **file.model_dump(include={item.name for item in fields(MeasuredSensor)}),
            **measured,
            setup=file.camera.value(),
        )


def write_sensor(
    path: str | Path, sensor: MeasuredSensor, provenance: Mapping[str, Any] | None = None
) -> None:
    """Write a measured sensor as sensor.json.

    Parameters
    ----------
    path
        File to write.
    sensor
        The figures.
    provenance
        What the writer records about itself, in JSON types; readers ignore it.

    Raises
    ------
    StorageError
        If the file cannot be written.

    Examples
    --------
    >>> from acquisition import MeasuredSensor
    >>> from acquisition.value_files import write_sensor
    >>> from acquisition.values import Measured
    >>> nothing = Measured(0.0, 0.0)
    >>> sensor = MeasuredSensor(12, 0.0, Measured(2.5, 0.01), *[nothing] * 5)
    >>> write_sensor("sensor.json", sensor)
    """
    figures: dict[str, float] = {}
    for name, figure in sensor.figures.items():
        figures |= {name: figure.value, f"{name}_sigma": figure.sigma}
    content: dict[str, Any] = {
        "format": "sgp-sensor",
        "version": 1,
        "time_utc": None if sensor.time_utc is None else sensor.time_utc.isoformat(),
        "camera": CameraNames.of(sensor.setup).model_dump(exclude_defaults=True),
        "bit_depth": sensor.bit_depth,
        "gain_db": sensor.gain_db,
        "figures": figures,
        "full_well_limit": sensor.full_well_limit,
        "hot_pixel_fraction": sensor.hot_pixel_fraction,
        "hot_pixel_e_per_s": sensor.hot_pixel_e_per_s,
        "provenance": dict(provenance or {}),
    }
    known = {key: value for key, value in content.items() if value is not None}
    write_durably(Path(path), f"{json.dumps(known, indent=1, allow_nan=False)}\n".encode())
