"""The installed rigs. This module imports no device, so that a refusal is quick."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from rig._errors import RigNotFoundError

DRIVERS = "sgp.rigs"


def rig_names() -> tuple[str, ...]:
    """Return the names of the installed rigs.

    Examples
    --------
    >>> from rig.config import rig_names
    >>> "simulated" in rig_names()
    True
    """
    return tuple(sorted(entry_points(group=DRIVERS).names))


def find_rig_file(name_or_path: str) -> Path | None:
    r"""Return the path of a rig file; None for the name of an installed rig.

    Parameters
    ----------
    name_or_path
        See `open_rig`.

    Raises
    ------
    RigNotFoundError
        If there is no such name or file.

    Examples
    --------
    >>> from pathlib import Path
    >>> from rig.config import find_rig_file
    >>> _ = Path("desk.toml").write_text('name = "desk"\ndriver = "simulated"\nleds = 4\n')
    >>> find_rig_file("desk.toml").name
    'desk.toml'
    """
    if name_or_path in rig_names():
        return None
    path = Path(name_or_path)
    if not (path.is_file() or path.name != name_or_path or path.suffix.lower() == ".toml"):
        raise RigNotFoundError(
            f"no rig is called {name_or_path!r} (known: {', '.join(rig_names()) or 'none'}) "
            "and no rig file of that name exists"
        )
    if not path.exists():
        raise RigNotFoundError(f"{path}: no such rig file")
    return path


def find_driver(name: str) -> EntryPoint | None:
    """Return the entry point of a driver; None if it is not installed."""
    return next((point for point in entry_points(group=DRIVERS) if point.name == name), None)
