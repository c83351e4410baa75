"""The options of a test, sorted into the objects that the virtual cameras take."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from simulator.camera import GentlDevice, ImageFormation

_GROUPS = {"formation": ImageFormation, "device": GentlDevice}


def grouped(**options: Any) -> dict[str, Any]:
    """Return the arguments of a virtual camera or rig for options by the names of their fields."""
    arguments = dict(options)
    for name, kind in _GROUPS.items():
        of_group = {one.name for one in fields(kind)} & set(options)
        if of_group:
            arguments[name] = kind(**{key: arguments.pop(key) for key in of_group})
    return arguments
