"""The installed rigs. This module imports no device, so that a refusal is quick."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points

DRIVERS = "sgp.rigs"


def rig_names() -> tuple[str, ...]:
    """Return the names of the installed rigs."""
    return tuple(sorted(entry_points(group=DRIVERS).names))


def find_driver(name: str) -> EntryPoint | None:
    """Return the entry point of a driver; None if it is not installed."""
    return next((point for point in entry_points(group=DRIVERS) if point.name == name), None)
