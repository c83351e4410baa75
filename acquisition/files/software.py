"""Name and version of the software that writes a file."""

from __future__ import annotations

from functools import cache
from importlib.metadata import PackageNotFoundError, version

SOFTWARE = "surface-geometry-processing"


@cache
def software_version() -> str:
    """Return the installed version, or ``unknown`` if the package is not installed.

    Examples
    --------
    >>> from acquisition.files import software_version
    >>> isinstance(software_version(), str)
    True
    """
    try:
        return version(SOFTWARE)
    except PackageNotFoundError:
        return "unknown"
