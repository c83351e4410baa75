"""What the user configured: the default rig and the default operator.

The file ``config.toml`` is in the folder ``sgp`` of the user's configuration folder:
``$XDG_CONFIG_HOME`` if it is set, else ``~/.config``, on macOS ``~/Library/Application Support``,
on Windows ``%APPDATA%``.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path

import rig
from sgp.cli.exit import UsageError

RIG_VARIABLE = "SGP_RIG"
_FILE = Path("sgp") / "config.toml"
_KEYS = ("operator", "rig")


@dataclass(frozen=True)
class DefaultRig:
    """The rig that commands use without ``--rig``.

    Parameters
    ----------
    name
        Name of a rig, or path of a rig file.
    origin
        Where this is configured: ``SGP_RIG``, or the path of the configuration file.
    """

    name: str
    origin: str


def config_path() -> Path | None:
    """Return the path of the configuration file; None if the user has no home folder."""
    stated = os.environ.get("XDG_CONFIG_HOME", "")
    if not os.path.isabs(stated) and sys.platform == "win32":
        stated = os.environ.get("APPDATA", "")
    if os.path.isabs(stated):  # as the XDG specification requires
        return Path(stated) / _FILE
    under = "Library/Application Support" if sys.platform == "darwin" else ".config"
    try:
        return Path.home() / under / _FILE
    except RuntimeError:
        return None


def default_rig() -> DefaultRig | None:
    """Return the configured rig, or None without one.

    A path in the configuration file is relative to the folder of this file.

    Raises
    ------
    UsageError
        If the configuration file is invalid.
    """
    if stated := os.environ.get(RIG_VARIABLE):
        return DefaultRig(stated, RIG_VARIABLE)
    path = config_path()
    name = _read(path).get("rig")
    if path is None or name is None:
        return None
    if os.path.basename(name) != name or name.lower().endswith(".toml"):
        name = str(path.parent / os.path.expanduser(name))
    return DefaultRig(name, str(path))


def chosen_rig(option: Path | None) -> str:
    """Return the rig of the option ``--rig``, or else the configured rig.

    Raises
    ------
    UsageError
        If there is neither, if the configured rig does not exist, or if the configuration file is
        invalid.
    RigNotFoundError
        If there is no rig or rig file of the name that the option gives.
    """
    if option is not None:
        rig.config.find_rig_file(str(option))  # a missing rig is reported before libraries load
        return str(option)
    default, names = default_rig(), rig.config.rig_names()
    if default is None:
        raise UsageError(
            f"--rig is missing: give a rig file (.toml) or one of {', '.join(names)}; for a "
            f"default, {how_to_configure()}"
        )
    if default.name not in names and not os.path.isfile(default.name):
        raise UsageError(
            f"{default.origin} names the rig {default.name}, which is neither a rig file nor one "
            f"of {', '.join(names)}: correct it, or give --rig"
        )
    return default.name


def chosen_operator(option: str | None) -> str:
    """Return the operator of the option ``--operator``, or else the configured one, or ``""``.

    Raises
    ------
    UsageError
        If the configuration file is invalid.
    """
    return _read(config_path()).get("operator", "") if option is None else option


def how_to_configure() -> str:
    """Return what to do for a default rig, as part of a message."""
    path = config_path()
    in_file = "" if path is None else f', or write rig = "..." into {path}'
    return f"set {RIG_VARIABLE}{in_file}"


def _read(path: Path | None) -> dict[str, str]:
    if path is None:
        return {}
    try:
        content = rig.files.parse_toml(rig.read_bounded(path, rig.files.MAX_TOML_BYTES))
    except FileNotFoundError:
        return {}
    except rig.UnreadableError as error:
        raise UsageError(f"{path}: {error}") from error
    for key, value in content.items():
        if key not in _KEYS:
            raise UsageError(f"{path}: unknown key {key!r}; known are {', '.join(_KEYS)}")
        if not isinstance(value, str) or not value:
            raise UsageError(f'{path}: {key} is not a text: write {key} = "..."')
    return content
