"""Comparison of a calibration with the LED positions of a rig file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from acquisition import DataError, LightErrors, Lights, led_of, lights_of_rig
from calibration._comparison.compare import LightComparison, compare_lights
from rig import RigConfig, check_type, pluralize

# Spheres up to 150 mm from the origin see a light at 450 mm in directions that differ by this.
_PARALLAX_DEG = 20.0


def compare_with_rig(lights: Lights, config: RigConfig) -> LightComparison:
    """Compare calibrated lights with the positions of the LEDs in a rig file.

    The positions of a rig file have the standard deviation ``led_positions_sigma_mm`` in x, y and
    z, by default that of a tape measure. A calibration without errors is exact in comparison. Of
    directions only the order is judged, and rotations of the whole by more than 20 degrees: they
    were measured at the spheres, not at the origin.

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
    stated = replace(lights_of_rig(config), calibrated=None)
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
    measured = replace(stated.take(leds), intensities=lights.intensities)
    if not lights.near:
        return _of_directions(lights, measured)
    return compare_lights(measured, replace(lights, ids=measured.ids, errors=_stated(lights)))


def _of_directions(lights: Lights, places: Lights) -> LightComparison:
    """Compare directions, which were not measured at the origin, but at the spheres.

    They may differ from those of the rig file by many degrees, in part like a common rotation.
    """
    measured = replace(places, errors=None).distant()
    compared = compare_lights(measured, replace(lights, ids=places.ids, errors=None))
    if compared.motion is None or compared.motion.angle_deg > _PARALLAX_DEG:
        return compared
    kept = (one for one in compared.warnings if one.code != "lights-moved-together")
    return replace(compared, warnings=tuple(kept))


def _stated(lights: Lights) -> LightErrors:
    """Return the errors of near lights with zero for covariances that are not known."""
    errors = lights.errors or LightErrors()
    zero = np.zeros((len(lights), 3, 3))
    known = zero if errors.covariances is None else np.nan_to_num(errors.covariances)
    return replace(errors, covariances=known)
