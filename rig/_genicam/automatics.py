"""Turns off the image processing in the camera, so that raw samples are comparable."""

from __future__ import annotations

from rig._errors import CameraError
from rig._genicam.nodes import Nodes

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
# Correction of defective pixels by their neighbours: an enumeration or a boolean, by vendor.
_DEFECT_CORRECTION = (
    "DefectCorrectStaticEnable",
    "DefectCorrectDynamicEnable",
    "DefectCorrectionEnable",
    "DefectPixelCorrection",
    "DefectPixelCorrectionEnable",
    "DefectPixelCorrectionMode",
    "DefectivePixelCorrection",
    "DefectMaskEnable",
    "BslDefectPixelCorrectionMode",
    "mvDefectivePixelEnable",
    "pgrDefectPixelCorrectionEnable",
    "defectivePixelReplacementMode",
)


def turn_off_automatics(nodes: Nodes) -> tuple[str, ...]:
    """Turn off every automatic of the camera, and check that it is off.

    Some nodes exist only with some pixel formats: call this again after the format has been chosen.

    Returns
    -------
    tuple of str
        The nodes that were on or had another value than required.

    Raises
    ------
    CameraError
        If a node refuses; the message names it.
    """
    changed = [name for name in _OFF if nodes.has(name) and nodes.set_choice(name, "Off")]
    if nodes.has("ExposureMode") and nodes.set_choice("ExposureMode", "Timed"):
        changed.append("ExposureMode")
    switches = (*_DISABLED, *_DEFECT_CORRECTION)
    changed += [name for name in switches if nodes.has(name) and _switch_off(nodes, name)]
    if _straighten_gamma(nodes):
        changed.append("Gamma")
    return tuple(changed)


def _switch_off(nodes: Nodes, name: str) -> bool:
    if nodes.is_choice(name):
        return nodes.set_choice(name, "Off")
    return nodes.set_flag(name, on=False)


def _straighten_gamma(nodes: Nodes) -> bool:
    if not nodes.has("Gamma"):
        return False
    bent = nodes.number("Gamma") != 1.0 and nodes.can_set("Gamma")
    if bent:
        nodes.set_number("Gamma", 1.0)
    switched_off = any(nodes.has(name) for name in _DISABLED[:2])
    if (gamma := nodes.number("Gamma")) != 1.0 and not switched_off:
        raise CameraError(f"camera {nodes.camera}, Gamma: was set to 1 but is still {gamma:g}")
    return bent
