"""Calibrations that are stored with a recording."""

from __future__ import annotations

from dataclasses import dataclass

from acquisition._values.camera_model import CameraModel
from acquisition._values.lights import Lights
from acquisition._values.noise_model import NoiseModel


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
