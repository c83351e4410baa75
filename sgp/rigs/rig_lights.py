"""The LED positions of a rig file: as lights, and compared with calibrated lights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import acquisition
import calibration
import rig
from sgp.cli.exit import UsageError
from sgp.cli.options import RIG_LIGHTS
from sgp.rigs.user_config import chosen_rig, default_rig, how_to_configure


class GivenLights(NamedTuple):
    """Lights that an option gives, and the file with them."""

    lights: acquisition.Lights
    file: Path


def given_lights(
    lights: Path, recordings: Sequence[Path] = (), option: Path | None = None
) -> GivenLights:
    """Return the lights that ``--lights`` gives: those of a file, or of a rig.

    The rig is that of ``--rig``, or else what the sessions recorded of theirs, or else the
    configured one.

    Raises
    ------
    MissingPathError, DataError
        If the file or a session cannot be read.
    RigError
        If the rig is not found or invalid.
    UsageError
        If no rig is known, it did not record the sessions, or it has no positions of LEDs.
    """
    if lights != RIG_LIGHTS:
        return GivenLights(acquisition.read_lights(lights), lights)
    manifests = [path / "session.toml" for path in recordings] if option is None else []
    recorded = [
        (path, acquisition.Session.open(path.parent, damaged_frames=True).manifest.rig)
        for path in manifests
        if path.is_file()
    ]
    known = [(path, one) for path, one in recorded if one is not None]
    positioned = [(path, one) for path, one in known if one.led_positions_mm]
    if not positioned and option is None and default_rig() is None:
        raise UsageError(
            "--lights rig: the rig is not known: give its rig file with --rig if the command has "
            f"this option, or {how_to_configure()}"
        )
    file = positioned[0][0] if positioned else Path(chosen_rig(option))
    config = positioned[0][1] if positioned else rig_with_positions(option)
    for path, other in known:
        if other.name != config.name:
            raise UsageError(
                f"--lights rig: {path.parent} was recorded on the rig {other.name}, and the "
                f"positions are those of the rig {config.name}: give the rig file with --rig, or "
                "configure this rig"
            )
    text = (
        f"the lights are the LEDs of the rig {config.name} at the positions of its rig file, with "
        f"standard deviations of {config.led_positions_sigma_mm:g} mm in x, y and z; their "
        "strengths are unknown and count as equal, unless --semi-calibrated or `sgp calibrate "
        "intensities` estimates them"
    )
    notice = rig.Notice("lights-of-rig", text, str(file), "info")
    known_lights = acquisition.value_files.lights_of_rig(config)
    return GivenLights(replace(known_lights, warnings=(notice,)), file)


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
    if option is None and any(acquisition.values.led_of(name) is None for name in lights.ids):
        return []
    compared = calibration.comparison.compare_with_rig(lights, config)
    return [replace(notice, where=f"rig {config.name}") for notice in compared.warnings]


def led_positions(option: Path | None, recorded_on: str) -> dict[str, tuple[float, ...]]:
    """Return the positions of the LEDs by their ids; none if the rig is not known.

    Parameters and errors are those of `rig_notices`.
    """
    config = _positioned_rig(option, recorded_on)
    places = () if config is None else config.led_positions_mm or ()
    return {acquisition.values.led_id(led): tuple(place) for led, place in enumerate(places)}


def _positioned_rig(option: Path | None, recorded_on: str) -> rig.RigConfig | None:
    """Return the rig of the option, or the configured rig if it recorded the images."""
    return _configured(recorded_on) if option is None else rig_with_positions(option)


def rig_with_positions(option: Path | None) -> rig.RigConfig:
    """Return the rig that ``--rig`` names, or else the configured one.

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
            f"the rig {config.name} has no led_positions_mm: add them to its rig file, or give "
            "another one with --rig"
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
