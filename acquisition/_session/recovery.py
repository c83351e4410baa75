"""A recording that was cut off, taken up again: nothing that was whole is lost."""

from __future__ import annotations

import os
from itertools import count
from pathlib import Path

from acquisition._errors import DataError
from acquisition._session.journal_file import JournalFile, utc_now
from acquisition._session.layout import FRAMES, JOURNAL, UNRECORDED, leaves
from acquisition._session.lock import lock_session
from acquisition._session.session import Session, examine
from acquisition._software import software_version
from acquisition._storage import disk, is_part, make_folder, sync_folder


def take_up(folder: Path) -> tuple[Session, JournalFile, int]:
    """Take an incomplete session for this process alone and make it ready to be gone on with.

    Returns
    -------
    session
        As it was found.
    journal
        Open, with a ``reopened`` event as its last line.
    lock
        Descriptor that holds the lock until it is closed.

    Raises
    ------
    MissingPathError, DataError, StorageError
        As `SessionWriter.reopen`. The lock is free then.
    """
    lock = lock_session(folder)
    try:
        found = examine(folder)
        session = found.sound()
        if session.complete:
            raise DataError(f"{folder}: is complete; record into a new folder")
        session.manifest.check_current(folder)
        aside = _set_aside(folder, {frame.path.name for frame in session.recorded})
        path = folder / JOURNAL
        if found.journal.lines:
            details = {"software_version": software_version(), "unrecorded": aside}
            journal = JournalFile.resume(path, found.journal, utc_now, details)
        else:
            journal = JournalFile.begin(path, found.toml_sha256, utc_now)
    except BaseException:
        os.close(lock)
        raise
    return session, journal, lock


def _set_aside(folder: Path, recorded: set[str]) -> list[str]:
    """Move files without a line out of ``frames/``, delete rests of unfinished writes.

    Parameters
    ----------
    folder
        The session, locked.
    recorded
        Names of the files that have a line.

    Returns
    -------
    list of str
        Where the files lie now, relative to the session.

    Raises
    ------
    DataError
        If ``frames/``, or where files are set aside, leads out of the session.
    StorageError
        If the disk refuses.
    """
    frames, shelf = folder / FRAMES, folder / UNRECORDED
    _check_inside(frames, folder)
    make_folder(frames)
    aside: list[str] = []
    with disk(frames, "clear up"):
        for path in sorted(frames.iterdir()):
            if path.name in recorded:
                continue
            if is_part(path):
                if not path.is_dir():  # hidden folders are not ours, and may stay
                    path.unlink()
                continue
            _check_inside(shelf, folder)
            make_folder(shelf)
            target = next(
                free
                for number in count()
                if not (free := shelf / f"{number:03d}_{path.name}").exists()
            )
            os.rename(path, target)
            sync_folder(shelf)
            aside.append(target.relative_to(folder).as_posix())
        sync_folder(frames)
    return aside


def _check_inside(path: Path, folder: Path) -> None:
    if leaves(path, folder):
        raise DataError(f"{path}: is a link that leaves the session; put the folder itself there")
