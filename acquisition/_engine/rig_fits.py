"""Checks before a session is created: exposures, calibrations and lights must fit the rig."""

from __future__ import annotations

from acquisition._errors import DataError, named
from acquisition._plan.plan import CapturePlan
from acquisition._session.manifest import Calibrations
from acquisition._values.lights import Lights, led_id
from rig import CameraError, CameraInfo, Rig


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
