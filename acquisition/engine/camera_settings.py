"""The settings of a camera in the journals of its sessions, and what has changed since the last."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from acquisition._errors import DataError, MissingPathError
from acquisition.session.journal import CAMERA_SETTINGS
from acquisition.session.layout import MANIFEST, is_session
from acquisition.session.manifest import parse_manifest
from acquisition.session.session import Session
from rig import CameraInfo, Notice, Rig, SgpError, listed, pluralize, read_bounded
from rig.files import MAX_TOML_BYTES

# The last sessions that are searched for one of the same camera, and the changes that are named.
_MOST_SESSIONS: Final = 50
_MOST_NAMED: Final = 8


def settings_events(info: CameraInfo) -> list[tuple[str, dict[str, Any]]]:
    """Return the event with the settings of a camera; none if it reports no settings."""
    details = {"turned_off": list(info.turned_off), "settings": dict(info.settings)}
    return [(CAMERA_SETTINGS, details)] if any(details.values()) else []


def camera_notices(rig: Rig, folder: str | Path) -> tuple[Notice, ...]:
    """Compare the settings of a camera with those of its last session.

    Parameters
    ----------
    rig
        Open rig.
    folder
        Session to resume, or folder of a new one: the last session is then the latest one of the
        same camera in the folders next to it.

    Returns
    -------
    tuple of Notice
        One with the settings that differ; empty if none does, or if there is no such session.

    Examples
    --------
    >>> from acquisition.engine import camera_notices
    >>> from simulator import open_rig_seeing, render, scene_named
    >>> view = render(scene_named("coin", width=64, height=52, leds=4))
    >>> with open_rig_seeing(view, realtime=False, camera="inside") as rig:
    ...     camera_notices(rig, "first")
    ()
    """
    info = rig.camera.info
    if not info.settings:
        return ()
    for session in _last_sessions(Path(folder), info.serial):
        stored = _settings(session)
        if stored is None:
            continue
        changes = [
            f"{name} was {stored[name]} and is {value}"
            for name, value in info.settings.items()
            if name in stored and stored[name] != value
        ]
        if not changes:
            return ()
        text = (
            f"{pluralize(len(changes), 'setting')} of camera {info.serial or info.model} changed "
            f"since {session.folder.name}: {listed(changes, _MOST_NAMED)}; if recordings must be "
            "comparable, restore them with the program of the vendor"
        )
        return (Notice("camera-settings-changed", text, severity="warning"),)
    return ()


def _settings(session: Session) -> Mapping[str, Any] | None:
    """Return the settings that the last event of a session states."""
    stated = [one.details for one in session.events if one.event == CAMERA_SETTINGS]
    settings = stated[-1].get("settings") if stated else None
    return settings if isinstance(settings, dict) else None


def _last_sessions(folder: Path, serial: str) -> Iterator[Session]:
    """Yield readable sessions of a camera, the latest first."""
    for path in [folder] if is_session(folder) else _siblings(folder, serial):
        try:
            yield Session.open(path, damaged_frames=True)
        except (DataError, MissingPathError):
            continue


def _siblings(folder: Path, serial: str) -> Iterator[Path]:
    """Yield the sessions of a camera next to a folder, the latest first."""
    try:
        paths = folder.absolute().parent.glob(f"*/{MANIFEST}")
        found = [(path.stat().st_mtime, path) for path in paths]
    except OSError:
        return
    dated = []
    for _, path in sorted(found, reverse=True)[:_MOST_SESSIONS]:
        try:
            manifest = parse_manifest(read_bounded(path, MAX_TOML_BYTES), path)
        except (SgpError, OSError):
            continue
        if manifest.camera.serial == serial and manifest.rig is not None:
            dated.append((manifest.started_utc, path.parent))
    yield from (path for _, path in sorted(dated, reverse=True))
