"""Comparison of a calibration with the LED positions of a rig file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from acquisition import DataError, LightErrors, Lights, led_id, led_of
from calibration._comparison.compare import LightComparison, compare_lights
from rig import RigConfig, check_type, pluralize

# Standard deviation of a coordinate that was measured with a tape measure.
_TAPE_MM = 10.0


def compare_with_rig(lights: Lights, config: RigConfig) -> LightComparison:
    """Compare calibrated lights with the positions of the LEDs in a rig file.

    The positions of a rig file may have been measured with a tape measure: they have a standard
    deviation of 10 mm in x, y and z. A calibration without errors is exact in comparison.

    Parameters
    ----------
    lights
        Lights with the ids of LEDs (``L07``), positions or directions; not all LEDs are required.
    config
        Configuration of the rig, with ``led_positions_mm``.

    Returns
    -------
    LightComparison
        Differences of the lights from the rig file. ``lights-changed`` names the lights that
        contradict it.

    Raises
    ------
    DataError
        If the rig file has no positions, or a light is not one of its LEDs.

    Examples
    --------
    >>> from acquisition import Lights
    >>> from calibration import compare_with_rig
    >>> from rig import RigConfig
    >>> places = [[300, 0, 300], [0, 310, 300], [-280, 0, 300]]
    >>> config = RigConfig(name="arc", driver="bench", leds=3, led_positions_mm=places)
    >>> compare_with_rig(Lights(positions_mm=[places[n] for n in (0, 2, 1)]), config).exchanged
    (('L01', 'L02'),)
    """
    check_type("lights", lights, Lights, "acquisition.read_lights(path) returns one")
    check_type("config", config, RigConfig, "rig.find_rig_config(name) returns one")
    if not config.led_positions_mm:
        raise DataError(f"the rig {config.name} has no led_positions_mm: add them to its rig file")
    leds = []
    for name in lights.ids:
        led = led_of(name)
        if led is None or led >= config.leds:
            raise DataError(
                f"light {name} is not one of the {pluralize(config.leds, 'LED')} of the rig "
                f"{config.name}: give lights of this rig"
            )
        leds.append(led)
    if len(set(leds)) < len(leds):
        twice = next(led for led in leds if leds.count(led) > 1)
        raise DataError(f"two lights belong to LED {twice}: give lights with one id per LED")
    tape = np.broadcast_to(_TAPE_MM**2 * np.eye(3), (len(leds), 3, 3))
    measured = Lights(
        positions_mm=np.array(config.led_positions_mm)[leds],
        ids=tuple(map(led_id, leds)),
        errors=LightErrors(covariances=tape),
        intensities=lights.intensities,
    )
    named = replace(lights, ids=measured.ids, errors=_stated(lights))
    return compare_lights(measured if lights.near else measured.distant(), named)


def _stated(lights: Lights) -> LightErrors:
    """Return the errors of lights with zero for covariances that are not known."""
    errors = lights.errors or LightErrors()
    size = 3 if lights.near else 2
    zero = np.zeros((len(lights), size, size))
    known = zero if errors.covariances is None else np.nan_to_num(errors.covariances)
    return replace(errors, covariances=known)
