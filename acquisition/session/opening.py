"""Opening of a session for writing: a new one, or an interrupted one without losing any frame."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

from acquisition._errors import DataError, MissingPathError, StorageError
from acquisition.files.software import software_version
from acquisition.files.storage import (
    disk,
    library_path,
    lock_folder,
    make_folder,
    part_path,
    sha256_of,
    sync_folder,
    write_durably,
)
from acquisition.files.text_files import to_toml
from acquisition.session.files_aside import clear_frames, set_frames_aside
from acquisition.session.frame_proofs import FrameProofs, damaged_frames_of
from acquisition.session.journal import EventLine
from acquisition.session.journal_file import Clock, JournalFile, utc_now
from acquisition.session.layout import COMPLETE, FRAMES, JOURNAL, MANIFEST, is_session
from acquisition.session.manifest import Manifest
from acquisition.session.session import Examination, Session, examine
from rig import Progress
from rig.host import filesystem


class OpenSession(NamedTuple):
    """A session that is locked for this process alone.

    Parameters
    ----------
    folder, manifest
        The session and its ``session.toml``.
    journal
        The open journal.
    lock
        Descriptor that holds the lock until it is closed.
    proofs
        Checks of its frames.
    session
        The session after reopening; None if it is new.
    set_aside_events
        Events of the frames that were set aside now.
    """

    folder: Path
    manifest: Manifest
    journal: JournalFile
    lock: int
    proofs: FrameProofs
    session: Session | None = None
    set_aside_events: tuple[EventLine, ...] = ()


def lock_session(folder: Path) -> int:
    """Lock an existing session for this process alone.

    Returns
    -------
    int
        Descriptor that holds the lock until it is closed.

    Raises
    ------
    MissingPathError
        If the folder does not exist.
    DataError
        If it is a file.
    StorageError
        If another process is writing to it.
    """
    if not folder.exists():
        raise MissingPathError(f"{folder}: no such folder")
    if not folder.is_dir():
        raise DataError(f"{folder}: is not a session: it is a file")
    return lock_folder(folder)


def take_up(folder: Path, *, set_aside_damaged: bool, on_progress: Progress) -> OpenSession:
    """Lock an incomplete session for this process alone and prepare it for new frames.

    Parameters
    ----------
    folder
        The session.
    set_aside_damaged
        Read back every frame and set damaged and lost ones aside. A complete session with such a
        frame is reopened, too.
    on_progress
        Receives the stage ``checking recorded frames``, one step per frame.

    Raises
    ------
    MissingPathError, DataError, StorageError
        As for `SessionWriter.reopen`. The lock is released.
    """
    with ExitStack() as undo:
        lock = lock_session(folder)
        undo.callback(filesystem.close, lock)
        examination = examine(folder)
        session = examination.sound(but_for_frames=set_aside_damaged)
        if session.complete and not set_aside_damaged:
            raise DataError(f"{folder}: is complete; record into a new folder")
        session.manifest.check_current(folder)
        proofs = FrameProofs(session.manifest.camera, session.recorded)
        damaged = damaged_frames_of(examination, proofs, on_progress) if set_aside_damaged else ()
        if session.complete and not damaged:
            raise DataError(f"{folder}: is complete and no frame is damaged; leave it as it is")
        journal = _reopened(examination, session)
        undo.callback(journal.close)
        events = set_frames_aside(session, journal, damaged)
        if damaged:
            session = examine(folder).sound()
            proofs.forget(one.frame for one in damaged)
        undo.pop_all()
        return OpenSession(folder, session.manifest, journal, lock, proofs, session, events)


def _reopened(examination: Examination, session: Session) -> JournalFile:
    """Move files without a line away, and open the journal with a new ``reopened`` event."""
    folder = session.folder
    if session.complete:
        # COMPLETE contains the hash of the journal, which is about to grow. Without COMPLETE the
        # session is incomplete, which is right, because some frames must be taken again.
        with disk(folder / COMPLETE, "remove"):
            filesystem.unlink(folder / COMPLETE)
            sync_folder(folder)
    aside = clear_frames(session)
    path = folder / JOURNAL
    if not examination.journal.lines:
        return JournalFile.begin(path, examination.toml_sha256, utc_now)
    details = {"software_version": software_version(), "unrecorded": aside}
    return JournalFile.resume(path, examination.journal, utc_now, details)


def begin(folder: Path, manifest: Manifest, clock: Clock) -> OpenSession:
    """Create a session in a new or empty folder and lock it for this process.

    Raises
    ------
    DataError, StorageError
        As for `SessionWriter.create`. The lock is released.
    """
    manifest.check_current(folder)
    library_path(folder)  # the image libraries require a UTF-8 path
    data = to_toml(manifest)
    outer = next((one for one in folder.absolute().parents if is_session(one)), None)
    if outer is not None:
        raise StorageError(f"{folder}: is inside the session {outer}; choose another folder")
    make_folder(folder)
    with ExitStack() as undo:
        lock = lock_folder(folder)
        undo.callback(filesystem.close, lock)
        with disk(folder, "list the folder"):
            names = sorted(path.name for path in folder.iterdir())
        # A temporary file of a creation that was killed does not count.
        if set(names) - {part_path(Path(MANIFEST)).name}:
            raise StorageError(
                f"{folder}: is not empty (it contains {names[-1]}); choose a new folder"
            )
        write_durably(folder / MANIFEST, data)
        make_folder(folder / FRAMES)
        journal = JournalFile.begin(folder / JOURNAL, sha256_of(data), clock)
        undo.pop_all()
        return OpenSession(folder, manifest, journal, lock, FrameProofs(manifest.camera))
