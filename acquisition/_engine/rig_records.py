"""An open rig as ``session.toml`` describes it."""

from __future__ import annotations

from typing import Any, Final

from acquisition._values.noise_model import NoiseModel
from rig import CameraInfo, Mounting, Rig

# Options of a rig file that select the board and camera by ports and files, which may change; the
# record names the devices themselves.
_WHERE: Final = ("board", "camera", "cti", "model", "port")


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
        "vendor": info.vendor,
        "model": info.model,
        "serial": info.serial,
        "width": info.width,
        "height": info.height,
        "pixel_format": info.pixel_format,
        "bit_depth": info.bit_depth,
        "cfa": info.cfa,
        "black_level_dn": 0.0 if sensor is None else sensor.black_level_dn,
        "white_level_dn": None if sensor is None else sensor.white_level_dn,
    }
