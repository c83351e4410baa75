"""Exposure time, gain, black level, temperature, times and triggers, under the names of vendors."""

from __future__ import annotations

import math
from typing import Literal

from rig._errors import CameraError, CameraGoneError
from rig.camera.interface import Trigger
from rig.genicam.nodes import Nodes

EXPOSURE = ("ExposureTime", "ExposureTimeAbs", "ExposureTimeRaw")
GAIN = ("Gain", "GainAbs", "GainRaw")
BLACK_LEVEL = ("BlackLevel", "BlackLevelAbs", "BlackLevelRaw")
TEMPERATURE = ("DeviceTemperature", "DeviceTemperatureAbs")
FRAME_RATE = ("AcquisitionFrameRate", "AcquisitionFrameRateAbs")
FRAME_RATE_ENABLE = ("AcquisitionFrameRateEnable", "AcquisitionFrameRateEnabled")
RESULTING_RATE = (
    "ResultingFrameRate",
    "ResultingFrameRateAbs",
    "AcquisitionResultingFrameRate",
    "AcquisitionFrameRateResult",
)
TRIGGER_DELAY = ("TriggerDelay", "TriggerDelayAbs")
SHUTTER = ("SensorShutterMode", "ShutterMode")
READOUT = ("SensorReadoutTime", "ReadoutTimeAbs", "ReadoutTime")

# Selectors of the nodes above, each with its symbols by preference.
_SELECT = (
    ("ExposureTimeSelector", ("Common",)),
    ("GainSelector", ("All", "AnalogAll")),
    ("BlackLevelSelector", ("All",)),
    ("DeviceTemperatureSelector", ("Sensor", "SensorBoard", "Mainboard")),
)
_MICROSECONDS = {"": 1.0, "us": 1.0, "µs": 1.0, "μs": 1.0, "ms": 1e3, "s": 1e6, "ns": 1e-3}
TRIGGER_NODES = (("TriggerMode",), ("TriggerSource",))
COMMAND = "TriggerSoftware"
# The selector's symbol for "one frame per trigger", the first that a camera offers.
_FRAME = ("FrameStart", "ExposureStart")


class Settings:
    """The adjustable values of a camera.

    Parameters
    ----------
    nodes
        Nodes of the camera.
    """

    def __init__(self, nodes: Nodes) -> None:
        self._nodes = nodes
        self._exposure_us: float | None = None
        self._gain_db = 0.0
        for selector, wanted in _SELECT:
            if nodes.can_set(selector) and (symbol := nodes.first_offered(selector, wanted)):
                nodes.set_choice(selector, symbol)

    @property
    def exposure_us(self) -> float:
        """Exposure time as last read back, NaN if the camera does not report it."""
        if self._exposure_us is None:
            self._exposure_us = self._time_us(EXPOSURE) if self._nodes.has(EXPOSURE) else math.nan
        return self._exposure_us

    @property
    def gain_db(self) -> float:
        """Gain as last read back; 0, the least, if the camera has no gain in dB."""
        return self._gain_db

    def exposure_range_us(self) -> tuple[float, float]:
        """Return the range of exposure times; (0, 0) if the camera does not report it."""
        if not self._nodes.has(EXPOSURE):
            return 0.0, 0.0
        scale = self._us_per_unit(EXPOSURE)
        low, high = self._nodes.limits(EXPOSURE)
        return low * scale, high * scale

    def set_exposure(self, exposure_us: float) -> float:
        """Set the exposure time and return it as read back."""
        scale = self._us_per_unit(EXPOSURE)
        self._exposure_us = None
        unit = self._nodes.unit(EXPOSURE) or "us"
        self._exposure_us = self._nodes.set_number(EXPOSURE, exposure_us / scale, unit) * scale
        return self._exposure_us

    def set_gain(self, gain_db: float) -> float:
        """Set the gain and return it as read back.

        Raises
        ------
        CameraError
            If it is out of range; or if the camera has no gain in dB and the value is not 0, which
            stands for the least gain.
        """
        nodes = self._nodes
        if nodes.has(GAIN) and nodes.unit(GAIN).lower() == "db":
            self._gain_db = nodes.set_number(GAIN, gain_db, "dB")
            return self._gain_db
        if gain_db != 0:
            raise CameraError(
                f"camera {nodes.camera}, {nodes.name(GAIN)}: a gain of {gain_db:g} dB is not "
                "possible, because this camera has no gain in dB; use 0, its least gain"
            )
        if nodes.can_set(GAIN):
            nodes.set_number(GAIN, nodes.limits(GAIN)[0])
        return 0.0

    def set_black_level(self, value: float) -> float:
        """Set the black level, in the camera's own unit, and return it as read back."""
        return self._nodes.set_number(BLACK_LEVEL, value)

    def set_frame_rate(self, rate_hz: float | None) -> None:
        """Limit the frame rate, or remove the limit if it is None."""
        nodes = self._nodes
        if nodes.can_set(FRAME_RATE_ENABLE):
            nodes.set_flag(FRAME_RATE_ENABLE, on=rate_hz is not None)
        if rate_hz is not None:
            nodes.set_number(FRAME_RATE, rate_hz, "Hz")

    def frame_period_us(self) -> float:
        """Return the least time between triggers at this exposure time, 0 if not reported."""
        nodes = self._nodes
        if nodes.has(RESULTING_RATE):
            rate_hz = nodes.number(RESULTING_RATE)
        elif not nodes.has(FRAME_RATE):
            return 0.0
        elif nodes.has(FRAME_RATE_ENABLE) and not nodes.flag(FRAME_RATE_ENABLE):
            rate_hz = nodes.limits(FRAME_RATE)[1]
        else:
            rate_hz = nodes.number(FRAME_RATE)
        return 1e6 / rate_hz if rate_hz > 0 else 0.0

    def trigger_delay_us(self) -> float:
        """Return the time from trigger to exposure, 0 if the camera has no node for it."""
        return self._time_us(TRIGGER_DELAY) if self._nodes.has(TRIGGER_DELAY) else 0.0

    def temperature_c(self) -> float | None:
        """Read the temperature, None if the camera does not report it."""
        return self._nodes.number(TEMPERATURE) if self._nodes.has(TEMPERATURE) else None

    def check_answers(self) -> None:
        """Read a value that changes, so that the answer is from the camera and not from a cache.

        Raises
        ------
        CameraGoneError
            If it does not answer.
        """
        try:
            self._nodes.number(TEMPERATURE if self._nodes.exists(TEMPERATURE) else "Width")
        except CameraGoneError:
            raise
        except CameraError as error:
            raise CameraGoneError(str(error)) from error

    def shutter(self) -> Literal["global", "rolling"]:
        """Return the kind of shutter; global if the camera has no node for it.

        Raises
        ------
        CameraError
            If rows begin together and end one after the other: no light gives them equal exposures.
        """
        nodes = self._nodes
        if not nodes.has(SHUTTER):
            return "global"
        mode = nodes.text(SHUTTER)
        plain = mode.lower().replace("_", "")
        if plain == "rolling":
            return "rolling"
        if plain == "global":
            return "global"
        raise CameraError(
            f"camera {nodes.camera}, {nodes.name(SHUTTER)}: in the mode {mode} rows are exposed "
            "for different times; set it to Global or Rolling with the vendor's program"
        )

    def readout_us(self) -> float:
        """Return how long the readout of a rolling shutter takes.

        If the camera has no node for it, this is the least frame period, which the readout cannot
        exceed.

        Raises
        ------
        CameraError
            If the camera reports neither.
        """
        nodes = self._nodes
        if nodes.has(READOUT):
            return self._time_us(READOUT)
        period_us = self.frame_period_us()
        if period_us == 0:
            raise CameraError(
                f"camera {nodes.camera} has a rolling shutter and does not report its readout time "
                f"({nodes.name(READOUT)}): set readout_us in the rig file"
            )
        return period_us

    def _time_us(self, names: tuple[str, ...]) -> float:
        return self._nodes.number(names) * self._us_per_unit(names)

    def _us_per_unit(self, names: tuple[str, ...]) -> float:
        unit = self._nodes.unit(names)
        # A raw integer without a unit counts ticks of a length that only the vendor knows.
        if unit not in _MICROSECONDS or (not unit and self._nodes.name(names).endswith("Raw")):
            raise CameraError(
                f"camera {self._nodes.camera}, {self._nodes.name(names)}: its unit "
                f"{unit or '(none)'} is not a unit of time"
            )
        return _MICROSECONDS[unit]


class TriggerControl:
    """The trigger nodes of a camera, for use while it is not acquiring.

    Parameters
    ----------
    nodes
        Nodes of the camera.
    line
        Symbol of the trigger source that is wired to the LED board.
    """

    def __init__(self, nodes: Nodes, line: str) -> None:
        self._nodes = nodes
        self._line = line

    def choose(self, trigger: Trigger) -> None:
        """Set the camera to take exactly one frame for each trigger of this kind.

        Raises
        ------
        CameraError
            If the camera cannot do this; if it lacks the line, the message lists its lines.
        """
        self.free()
        nodes = self._nodes
        self._select_frames()
        nodes.set_choice("TriggerSource", "Software" if trigger == "software" else self._line)
        if trigger == "line":
            self._make_input()
        nodes.set_choice("TriggerMode", "On")

    def free(self) -> None:
        """Turn off all triggers, so that the camera runs freely."""
        nodes = self._nodes
        if nodes.has("AcquisitionMode"):
            nodes.set_choice("AcquisitionMode", "Continuous")
        if not nodes.has("TriggerMode"):
            return
        if nodes.can_set("TriggerSelector"):
            for symbol in nodes.choices("TriggerSelector"):
                nodes.set_choice("TriggerSelector", symbol)
                if nodes.has("TriggerMode"):
                    nodes.set_choice("TriggerMode", "Off")
        else:
            nodes.set_choice("TriggerMode", "Off")

    def fire(self) -> None:
        """Trigger one frame by software."""
        self._nodes.execute(COMMAND)

    def _select_frames(self) -> None:
        nodes = self._nodes
        if not nodes.has("TriggerSelector"):
            return
        symbol = nodes.first_offered("TriggerSelector", _FRAME)
        if symbol is None:
            raise CameraError(
                f"camera {nodes.camera}, TriggerSelector: none of {', '.join(_FRAME)} is "
                f"available, only {', '.join(nodes.choices('TriggerSelector'))}"
            )
        nodes.set_choice("TriggerSelector", symbol)

    def _make_input(self) -> None:
        nodes = self._nodes
        if nodes.has("TriggerActivation"):
            nodes.set_choice("TriggerActivation", "RisingEdge")
        if nodes.can_set("LineSelector") and self._line in nodes.choices("LineSelector"):
            nodes.set_choice("LineSelector", self._line)
            if nodes.has("LineMode"):
                nodes.set_choice("LineMode", "Input")
