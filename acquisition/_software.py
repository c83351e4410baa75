"""Which software, and which version of it, wrote a file."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

SOFTWARE = "surface-geometry-processing"


def software_version() -> str:
    """Return the installed version, or ``unknown`` when run from files that were not installed."""
    try:
        return version(SOFTWARE)
    except PackageNotFoundError:
        return "unknown"
