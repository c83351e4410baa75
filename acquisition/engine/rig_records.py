"""An open rig as ``session.toml`` describes it; plan, calibrations and session must fit it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel

from acquisition._errors import DataError, named
from acquisition.plan.plan import CapturePlan
from acquisition.session.manifest import Calibrations, CameraRecord, Manifest, RigRecord
from acquisition.values.lights import Lights, led_id
from acquisition.values.noise_model import NoiseModel
from rig import CameraError, CameraInfo, Mounting, Rig

# Options of a rig file that say where board and camera are and how they are opened, which may
# change; the record names the devices themselves.
_WHERE: Final = ("board", "camera", "cti", "isolate", "model", "port")


def rig_record(rig: Rig) -> dict[str, Any]:
    """Return the fields of `RigRecord`: the rig file, and how the board identified itself."""
    config, board = rig.config, rig.board.identity
    return {
        "name": config.name,
        "driver": config.driver,
        "board": board.name,
        "protocol": str(board.protocol),
        "firmware": board.firmware,
        "leds": board.leds,
        "mounting": None if config.mounting == Mounting() else config.mounting,
        "dead_leds": config.dead_leds,
        "trigger": config.trigger,
        "options": {
            name: value
            for name, value in config.options.items()
            if value is not None and name not in _WHERE
        }
        or None,
        "led_positions_mm": config.led_positions_mm or None,
        "led_positions_sigma_mm": config.led_positions_sigma_mm
        if config.led_positions_mm
        else None,
    }


def camera_record(info: CameraInfo, sensor: NoiseModel | None) -> dict[str, Any]:
    """Return the fields of `CameraRecord`; black and white level are the sensor's, if known."""
    return {
        **{name: getattr(info, name) for name in CameraRecord.model_fields if hasattr(info, name)},
        "black_level_dn": 0.0 if sensor is None else sensor.black_level_dn,
        "white_level_dn": None if sensor is None else sensor.white_level_dn,
    }


def check_exposures(info: CameraInfo, plan: CapturePlan) -> None:
    """Refuse exposure times outside the camera's range.

    Raises
    ------
    CameraError
        If an exposure time is outside; the message names the range.
    """
    low, high = info.exposure_min_us, info.exposure_max_us
    for exposure_us in plan.distinct_exposures_us:
        if not low <= exposure_us <= high:
            raise CameraError(
                f"the plan requires {exposure_us:g} us, camera {info.model} {info.serial} exposes "
                f"for {low:g} to {high:g} us: correct exposures_us in the plan"
            )


def check_calibrations(rig: Rig, plan: CapturePlan, calibrations: Calibrations) -> None:
    """Refuse calibrations for another image size, bit depth or set of LEDs.

    Raises
    ------
    DataError
        If size or bit depth differ; the message says what to do.
    """
    info = rig.camera.info
    size = rig.config.mounting.upright_shape((info.height, info.width))
    camera_model, sensor = calibrations.camera_model, calibrations.sensor
    if camera_model is not None and camera_model.size != size:
        raise DataError(
            f"the camera model is for {camera_model.width} x {camera_model.height} pixels, the "
            f"camera delivers upright images of {size[1]} x {size[0]} pixels; calibrate the camera "
            "at this size"
        )
    if sensor is not None and sensor.bit_depth != info.bit_depth:
        raise DataError(
            f"the sensor model is for {sensor.bit_depth} bits, the camera delivers "
            f"{info.bit_depth} bits; measure the sensor in this pixel format"
        )
    if calibrations.lights is not None:
        _check_lights(calibrations.lights, plan)


def _check_lights(lights: Lights, plan: CapturePlan) -> None:
    """Refuse lights that lack an LED of the plan or cannot be matched with the LEDs by name."""
    wanted = [led_id(led) for led in plan.leds]
    with named("the lights do not fit the plan"):
        _, by_name = lights.match(wanted)
    if not by_name:
        raise DataError(
            f"the lights are named {lights.ids[0]} and so on, the LEDs of the plan {wanted[0]} and "
            "so on: give the lights of this rig, named after its LEDs"
        )


def check_same(
    folder: Path, stored: Manifest, current: Manifest, plan: CapturePlan | None = None
) -> None:
    """Refuse to mix frames of different rigs, cameras or plans in one session.

    More LEDs may be listed as dead than before, but not fewer. The positions of the LEDs may have
    been measured since.

    Parameters
    ----------
    folder
        The session, for the message.
    stored
        Manifest of the session.
    current
        Manifest that the session would have if it started now.
    plan
        The requested plan, if there is one.

    Raises
    ------
    DataError
        If anything differs; the message names each difference.
    """
    differences = [
        *_differences("rig", stored.rig, _with_what_may_differ(stored.rig, current.rig)),
        *_differences("camera", stored.camera, current.camera),
        *(() if plan is None else _differences("plan", stored.plan, plan)),
    ]
    if differences:
        kinds = dict.fromkeys(kind for kind, _ in differences)
        raise DataError(
            f"{folder}: was started with another {' and another '.join(kinds)}: "
            f"{'; '.join(text for _, text in differences)}; use the original ones, or record into "
            "a new folder"
        )


def _with_what_may_differ(stored: RigRecord | None, current: RigRecord | None) -> RigRecord | None:
    if stored is None or current is None:
        return current
    names = ["led_positions_mm", "led_positions_sigma_mm"]
    names += ["dead_leds"] if set(stored.dead_leds) <= set(current.dead_leds) else []
    return current.model_copy(update={name: getattr(stored, name) for name in names})


def _differences(
    kind: str, stored: BaseModel | None, current: BaseModel | None
) -> Iterator[tuple[str, str]]:
    before = {} if stored is None else stored.model_dump()
    after = {} if current is None else current.model_dump()
    options = before.pop("options", None) or {}, after.pop("options", None) or {}
    for what, one, other in ((kind, before, after), (f"{kind} option", *options)):
        for name in dict.fromkeys((*one, *other)):
            if one.get(name) != other.get(name):
                change = f"was {_text(one.get(name))} and is {_text(other.get(name))}"
                yield kind, f"{what} {name} {change}"


def _text(value: object) -> str:
    return "not stated" if value is None or value == "" else str(value)
