"""A recording that was cut off, taken up again: nothing that was whole is lost."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from acquisition._errors import DataError
from acquisition._session.damaged import damaged_frames_of
from acquisition._session.frame_proofs import FrameProofs
from acquisition._session.journal import EventLine
from acquisition._session.journal_file import JournalFile, utc_now
from acquisition._session.layout import COMPLETE, JOURNAL
from acquisition._session.lock import lock_session
from acquisition._session.session import Examination, Session, examine
from acquisition._session.set_aside import clear_frames, set_frames_aside
from acquisition._software import software_version
from acquisition._storage import disk, sync_folder
from rig import Progress, no_progress


@dataclass(frozen=True, eq=False)
class TakenUp:
    """A session ready to be gone on with.

    Parameters
    ----------
    session
        As it is now.
    journal
        Open.
    lock
        Descriptor that holds the lock until it is closed.
    proofs
        Which of its frames were read back.
    events
        Of the frames that were set aside now.
    """

    session: Session
    journal: JournalFile
    lock: int
    proofs: FrameProofs
    events: tuple[EventLine, ...]


def take_up(
    folder: Path,
    *,
    set_aside_damaged: bool = False,
    on_progress: Progress = no_progress,
) -> TakenUp:
    """Take an incomplete session for this process alone and make it ready to be gone on with.

    Parameters
    ----------
    folder
        The session.
    set_aside_damaged
        Read every frame back and set those aside that are damaged or lost. A complete session with
        such a frame is taken up too.
    on_progress
        Receives the stage ``checking recorded frames``, one step per frame.

    Raises
    ------
    MissingPathError, DataError, StorageError
        As `SessionWriter.reopen`. The lock is free then.
    """
    lock = lock_session(folder)
    try:
        found = examine(folder)
        session = found.sound(but_for_frames=set_aside_damaged)
        if session.complete and not set_aside_damaged:
            raise DataError(f"{folder}: is complete; record into a new folder")
        session.manifest.check_current(folder)
        proofs = FrameProofs(session.manifest.camera, session.recorded)
        damaged = damaged_frames_of(found, proofs, on_progress) if set_aside_damaged else ()
        if session.complete and not damaged:
            raise DataError(f"{folder}: is complete and no frame is damaged; leave it as it is")
        events: tuple[EventLine, ...] = ()
        journal = _reopened(found, session)
        if damaged:
            try:
                events = set_frames_aside(session, journal, damaged)
                session = examine(folder).sound()
                proofs.forget(one.frame for one in damaged)
            except BaseException:
                journal.close()
                raise
    except BaseException:
        os.close(lock)
        raise
    return TakenUp(session, journal, lock, proofs, events)


def _reopened(found: Examination, session: Session) -> JournalFile:
    """Clear up, and open the journal with a ``reopened`` event as its last line."""
    folder = session.folder
    if session.complete:
        # The journal that it names is about to grow. Without it the session is incomplete, which it
        # is, as frames of it have to be taken again.
        with disk(folder / COMPLETE, "remove"):
            (folder / COMPLETE).unlink()
            sync_folder(folder)
    names = frozenset(frame.path.name for frame in session.recorded)
    aside = clear_frames(folder, names, session.set_aside)
    path = folder / JOURNAL
    if not found.journal.lines:
        return JournalFile.begin(path, found.toml_sha256, utc_now)
    details = {"software_version": software_version(), "unrecorded": aside}
    return JournalFile.resume(path, found.journal, utc_now, details)
