"""The public names: those at the top of a package, and those of its namespaces."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from types import ModuleType

ROOMS = ("rig", "acquisition", "calibration", "processing", "simulator")


def namespaces(room: str) -> list[str]:
    """Return the full names of the namespaces of a package."""
    module = importlib.import_module(room)
    return [
        f"{room}.{name}" for name in module.__all__ if isinstance(getattr(module, name), ModuleType)
    ]


NAMESPACES = tuple(name for room in ROOMS for name in namespaces(room))


def public_values() -> Iterator[tuple[str, object]]:
    """Yield every public value once, with the shortest name under which it is imported."""
    for room in ROOMS:
        yielded = set()
        for place in (room, *namespaces(room)):
            module = importlib.import_module(place)
            for name in module.__all__:
                value = getattr(module, name)
                if name not in yielded and not isinstance(value, ModuleType):
                    yielded.add(name)
                    yield f"{place}.{name}", value
