"""Files that no longer count: they are kept elsewhere in the session, never deleted."""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import count
from pathlib import Path

from acquisition._errors import DataError
from acquisition.files.software import software_version
from acquisition.files.storage import disk, is_hidden, make_folder, sync_folder
from acquisition.session.journal import SET_ASIDE, UPGRADED, EventLine
from acquisition.session.journal_file import JournalFile
from acquisition.session.layout import FRAMES, SET_ASIDE_FOLDER, UNRECORDED, leaves
from acquisition.session.session import Session
from acquisition.session.session_frame import Damage
from rig.host import filesystem

# The first format version that has the event.
_SINCE = 3


def set_frames_aside(
    session: Session, journal: JournalFile, damaged: Sequence[Damage]
) -> tuple[EventLine, ...]:
    """Set damaged frames aside: for each, write the event, then move the file.

    If the process is killed in between, the event names the place of the file, and `clear_frames`
    moves it there later. In the opposite order a file would be missing without explanation.

    Parameters
    ----------
    session
        Locked session of a version that this program writes; it is upgraded if its version does not
        have the event.
    journal
        The open journal.
    damaged
        The damaged frames.

    Returns
    -------
    tuple of EventLine
        The events written.

    Raises
    ------
    DataError
        If ``derived/set_aside`` leads out of the session.
    StorageError
        If the disk refuses.
    """
    if not damaged:
        return ()
    lines = []
    folder = session.folder
    shelf = folder / SET_ASIDE_FOLDER
    _check_inside(shelf, folder)
    make_folder(shelf)
    if session.format_version < _SINCE:
        details = {
            "from_version": session.format_version,
            "to_version": _SINCE,
            "software_version": software_version(),
        }
        lines.append(journal.append(EventLine, {"event": UPGRADED, "details": details}))
    for frame, reason in ((one.frame, one.reason) for one in damaged):
        kept = _free(shelf, frame.path.name)
        there = os.path.lexists(frame.path)
        details = {
            "frame_seq": frame.line.seq,
            "file": frame.path.relative_to(folder).as_posix(),
            "kept": kept.relative_to(folder).as_posix() if there else None,
            # Error texts of libraries may contain any characters.
            "reason": reason.encode("ascii", "backslashreplace").decode("ascii"),
        }
        lines.append(journal.append(EventLine, {"event": SET_ASIDE, "details": details}))
        if there:
            _move(frame.path, kept)
    return tuple(lines)


def clear_frames(session: Session) -> list[str]:
    """Keep only recorded files in ``frames/``: move others away, delete unfinished ones.

    A file of a frame that was set aside, and has not been moved yet, moves to the place that its
    event names.

    Parameters
    ----------
    session
        The session, locked.

    Returns
    -------
    list of str
        New paths of files without a line, relative to the session.

    Raises
    ------
    DataError
        If ``frames/`` or a target folder leads out of the session.
    StorageError
        If the disk refuses.
    """
    folder, recorded = session.folder, {frame.path.name for frame in session.recorded}
    frames, shelf = folder / FRAMES, folder / UNRECORDED
    _check_inside(frames, folder)
    make_folder(frames)
    places = {aside.frame.path.name: aside.kept for aside in session.set_aside}
    aside: list[str] = []
    with disk(frames, "list"):
        paths = sorted(frames.iterdir())
    for path in paths:
        if path.name in recorded:
            continue
        if is_hidden(path):
            if not path.is_dir():  # hidden folders belong to other programs and stay
                with disk(path, "remove"):
                    filesystem.unlink(path)
            continue
        place = places.get(path.name)
        target = place if place is not None and not os.path.lexists(place) else None
        _check_inside((target or shelf / path.name).parent, folder)
        make_folder((target or shelf / path.name).parent)
        if target is None:
            target = _free(shelf, path.name)
            aside.append(target.relative_to(folder).as_posix())
        _move(path, target)
    with disk(frames, "sync"):
        sync_folder(frames)
    return aside


def _free(shelf: Path, name: str) -> Path:
    """Return an unused path."""
    paths = (shelf / f"{number:03d}_{name}" for number in count())
    return next(path for path in paths if not os.path.lexists(path))


def _move(path: Path, target: Path) -> None:
    with disk(path, "set aside"):
        filesystem.rename(path, target)
        sync_folder(target.parent)
        sync_folder(path.parent)


def _check_inside(path: Path, folder: Path) -> None:
    if leaves(path, folder):
        raise DataError(f"{path}: is a link that leaves the session; put the folder itself there")
