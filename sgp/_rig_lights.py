"""Whether calibrated lights contradict the LED positions of a rig file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import acquisition
import calibration
import rig
from sgp._exit import UsageError
from sgp._user_config import chosen_rig, default_rig


def rig_notices(
    lights: acquisition.Lights, option: Path | None, recorded_on: str
) -> list[rig.Notice]:
    """Compare lights with the rig of ``--rig``, or with the configured rig if it recorded them.

    Parameters
    ----------
    lights
        The calibrated lights.
    option
        What the option ``--rig`` names; None without the option.
    recorded_on
        Name of the rig that recorded the spheres; empty if it is not known.

    Raises
    ------
    RigError, DataError
        If the rig of the option is not found or invalid, has no positions, or has other LEDs.
    """
    config = _positioned_rig(option, recorded_on)
    if config is None:
        return []
    if option is None and any(acquisition.led_of(name) is None for name in lights.ids):
        return []
    compared = calibration.compare_with_rig(lights, config)
    return [replace(notice, where=f"rig {config.name}") for notice in compared.warnings]


def led_positions(option: Path | None, recorded_on: str) -> dict[str, tuple[float, ...]]:
    """Return the positions of the LEDs by their ids; none if the rig is not known.

    Parameters and errors are those of `rig_notices`.
    """
    config = _positioned_rig(option, recorded_on)
    places = () if config is None else config.led_positions_mm or ()
    return {acquisition.led_id(led): tuple(place) for led, place in enumerate(places)}


def _positioned_rig(option: Path | None, recorded_on: str) -> rig.RigConfig | None:
    """Return the rig of the option, or the configured rig if it recorded the images."""
    return _configured(recorded_on) if option is None else rig_with_positions(option)


def rig_with_positions(option: Path | None) -> rig.RigConfig:
    """Return the rig that ``--rig`` names.

    Raises
    ------
    RigError
        If it is not found or invalid.
    UsageError
        If it has no positions of LEDs.
    """
    config = rig.find_rig_config(chosen_rig(option))
    if not config.led_positions_mm:
        raise UsageError(
            f"--rig {option}: the rig {config.name} has no led_positions_mm to compare with: add "
            "them to its rig file"
        )
    return config


def _configured(recorded_on: str) -> rig.RigConfig | None:
    """Return the configured rig if it has this name, as many LEDs and positions."""
    try:
        default = default_rig()
        config = None if default is None else rig.find_rig_config(default.name)
    except (UsageError, rig.RigError):
        return None  # the command needs no rig: another one reports what is wrong with it
    if config is None or config.name != recorded_on or not config.led_positions_mm:
        return None
    return config
