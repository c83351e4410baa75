"""Turns off the image processing in the camera, so that raw samples are comparable."""

from __future__ import annotations

import contextlib
import itertools
import re

from rig._errors import CameraError
from rig.genicam.nodes import Nodes, Setting
from rig.genicam.processing import PROCESSING, UNRECORDED, Processing

# Size and offset along the axis that a binning concerns; the offset fits only the larger size.
_AXES = {
    "Horizontal": ("Width", "OffsetX"),
    "Vertical": ("Height", "OffsetY"),
    "X": ("Width", "OffsetX"),
    "Y": ("Height", "OffsetY"),
}
# A gamma of 1.002 moves no sample by more than 0.08 % of the range: a register rounds so.
_ROUNDED = 2e-3


def turn_off_automatics(nodes: Nodes) -> tuple[str, ...]:
    """Turn off all processing that alters samples, and check that it is off.

    A node with a value for each entry of a selector is set for every entry. Some nodes exist only
    with some pixel formats: call this again after the format has been chosen.

    Returns
    -------
    tuple of str
        The nodes that were on or had another value than required.

    Raises
    ------
    CameraError
        If a node refuses; the message names it.
    """
    changed: dict[str, None] = {}
    # Levels last: many can only be written while their switch is off.
    for matches, set_neutral in (
        (Processing.has_switch, _switch_off),
        (Processing.has_level, _set_level),
    ):
        for kind, name in itertools.product(PROCESSING, nodes.names()):
            if matches(kind, name):
                for entry in nodes.entries(name):
                    if re.search(kind.entries, entry) and set_neutral(nodes, name, kind):
                        changed[name] = None
    return tuple(changed)


def camera_settings(nodes: Nodes) -> dict[str, Setting]:
    """Return the settings of the camera that this program does not make itself, by node.

    These are the nodes that can be written now, and those of processing, also if they cannot.
    """
    settings: dict[str, Setting] = {}
    for name in nodes.names():
        processing = any(kind.has_switch(name) or kind.has_level(name) for kind in PROCESSING)
        recorded = processing or nodes.can_set(name)
        if recorded and nodes.has(name) and not UNRECORDED.fullmatch(name):
            with contextlib.suppress(CameraError):  # for instance an undefined enumeration value
                settings[name] = nodes.value(name)
    return settings


def _switch_off(nodes: Nodes, name: str, kind: Processing) -> bool:
    """Turn a switch off; return whether it was on."""
    if not nodes.has(name) or (kind.locked == "stated" and not nodes.can_set(name)):
        return False
    if nodes.is_flag(name):
        return nodes.set_flag(name, on=False)
    if not nodes.is_choice(name) or nodes.text(name) in kind.symbols:
        return False
    symbol = nodes.first_offered(name, kind.symbols)
    if symbol is None and not kind.required:
        return False  # it chooses between variants, and another node turns them off
    return nodes.set_choice(name, symbol or kind.symbols[0])


def _set_level(nodes: Nodes, name: str, kind: Processing) -> bool:
    """Set the strength of processing to its neutral value; return whether it was another."""
    if not nodes.has(name) or not nodes.is_number(name):
        return False
    low, high = nodes.limits(name)
    if not kind.knows(low, high):
        return False
    before, neutral = nodes.number(name), min(max(kind.neutral, low), high)
    if before != neutral and nodes.can_set(name):
        nodes.set_number(name, neutral)
    after = nodes.number(name)
    differs = abs(after - kind.neutral) > _ROUNDED
    if differs and kind.locked == "refused" and not _has_switch(nodes, kind):
        raise CameraError(
            f"camera {nodes.camera}, {name}: was set to {kind.neutral:g} but is still {after:.9g}"
        )
    if after != before:
        _enlarge(nodes, name, before / max(after, 1.0))
    return after != before


def _has_switch(nodes: Nodes, kind: Processing) -> bool:
    return any(
        kind.has_switch(name) and nodes.has(name) and not nodes.is_number(name)
        for name in nodes.names()
    )


def _enlarge(nodes: Nodes, name: str, factor: float) -> None:
    """Keep the field of view after binning or decimation along an axis was reduced."""
    axis = next((axis for end, axis in _AXES.items() if name.endswith(end)), ())
    for side in axis:
        if nodes.can_set(side):
            low, high = nodes.limits(side)
            nodes.set_number(side, min(max(nodes.number(side) * factor, low), high))
