"""What a camera does to its pictures by itself, turned off: raw samples have to be comparable."""

from __future__ import annotations

from rig._errors import CameraError
from rig._genicam_nodes import Nodes

_OFF = (
    "ExposureAuto",
    "GainAuto",
    "BalanceWhiteAuto",
    "BlackLevelAuto",
    "GainAutoBalance",
    "BlackLevelAutoBalance",
    "TestPattern",
    "TestImageSelector",
)
_DISABLED = ("GammaEnable", "GammaEnabled", "LUTEnable", "SharpnessEnable", "NoiseReductionEnable")


def turn_off_automatics(nodes: Nodes) -> None:
    """Turn every automatic that the camera has off, and check that it is.

    Raises
    ------
    CameraError
        If one refuses; the message names its node.
    """
    for name in _OFF:
        if nodes.has(name):
            nodes.set_choice(name, "Off")
    if nodes.has("ExposureMode"):
        nodes.set_choice("ExposureMode", "Timed")
    for name in _DISABLED:
        if nodes.has(name):
            nodes.set_flag(name, on=False)
    _straighten_gamma(nodes)


def _straighten_gamma(nodes: Nodes) -> None:
    if not nodes.has("Gamma"):
        return
    if nodes.number("Gamma") != 1.0 and nodes.can_set("Gamma"):
        nodes.set_number("Gamma", 1.0)
    switched_off = any(nodes.has(name) for name in _DISABLED[:2])
    if (gamma := nodes.number("Gamma")) != 1.0 and not switched_off:
        raise CameraError(f"camera {nodes.camera}, Gamma: was set to 1 but stays {gamma:g}")
