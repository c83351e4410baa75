"""Lights from the positions of the LEDs in a rig file."""

from __future__ import annotations

import numpy as np

from acquisition._errors import DataError
from acquisition._session.manifest import RigRecord
from acquisition._values.light_errors import LightErrors
from acquisition._values.lights import Lights
from acquisition._values.setup import Calibrated, Setup
from rig import RigConfig, check_type


def lights_of_rig(config: RigConfig | RigRecord) -> Lights:
    """Return the lights of a rig: its LEDs at the positions that its rig file states.

    Their strengths are not known and count as equal; they shine alike in all directions.

    Parameters
    ----------
    config
        Configuration of the rig, or what a session has recorded of it.

    Returns
    -------
    Lights
        All LEDs by their ids, ``L07`` for LED 7, with the covariances of their positions.

    Raises
    ------
    DataError
        If the configuration has no ``led_positions_mm``.

    Examples
    --------
    >>> from acquisition import lights_of_rig
    >>> from rig import RigConfig
    >>> places = [[300, 0, 300], [0, 310, 300], [-280, 0, 300]]
    >>> lights_of_rig(RigConfig(name="arc", driver="bench", leds=3, led_positions_mm=places))
    Lights(3 positions in mm, L00 to L02)
    """
    if not isinstance(config, RigRecord):
        check_type("config", config, RigConfig, "rig.find_rig_config(name) returns one")
    if not config.led_positions_mm or not config.led_positions_sigma_mm:
        raise DataError(f"the rig {config.name} has no led_positions_mm: add them to its rig file")
    covariance = config.led_positions_sigma_mm**2 * np.eye(3)
    return Lights(
        positions_mm=np.array(config.led_positions_mm),
        errors=LightErrors(np.tile(covariance, (len(config.led_positions_mm), 1, 1))),
        calibrated=Calibrated(setup=Setup(rig=config.name)),
    )
