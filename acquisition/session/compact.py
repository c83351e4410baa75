"""Lossless compaction of sessions that survives a crash at any moment."""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from acquisition._errors import DataError, StorageError
from acquisition.files.software import software_version
from acquisition.files.storage import (
    disk,
    make_folder,
    published,
    read_back,
    read_file,
    sha256_of,
    sync_folder,
    write_durably,
    write_whole,
)
from acquisition.pixels.compact_tiff import deflate_tiff
from acquisition.pixels.encoded_image import holds
from acquisition.session.journal import COMPACTED, REOPENED, EventLine, Journal
from acquisition.session.journal_file import JournalFile, utc_now
from acquisition.session.layout import (
    ASIDE,
    COMPLETE,
    FRAMES,
    JOURNAL,
    completion_mark,
    leaves,
)
from acquisition.session.opening import lock_session
from acquisition.session.session import Session, examine
from acquisition.session.session_frame import SessionFrame
from rig import Progress, no_progress
from rig.host import filesystem


@dataclass(frozen=True)
class Compaction:
    """Result of a compaction.

    Parameters
    ----------
    folder
        The session.
    frames
        Number of frames of the session, including retaken and rejected ones.
    compacted
        Number of frames that this call compressed.
    bytes_before, bytes_after
        Size of all frame files.
    complete
        True if the session is complete; compaction does not change this.
    """

    folder: Path
    frames: int
    compacted: int
    bytes_before: int
    bytes_after: int
    complete: bool


def compact_session(
    folder: str | Path,
    *,
    on_progress: Progress = no_progress,
) -> Compaction:
    """Replace the frame files of a session by compressed TIFF files with identical pixels.

    Every frame is checked against its hashes, compressed, read back and compared. The new file is
    written first, then the ``compacted`` event, and only then the old file is removed. COMPLETE is
    set aside before the journal grows and written again at the end, even after an error. A
    compaction that was killed leaves a session that verifies as intact but incomplete; the next
    compaction continues and makes it complete again.

    Parameters
    ----------
    folder
        The session, complete or not.
    on_progress
        Receives the stage ``compacting``, one step per frame.

    Returns
    -------
    Compaction
        Frames that do not get smaller keep their file and are not counted.

    Raises
    ------
    MissingPathError
        If the folder does not exist.
    DataError
        If it is not a session, or is damaged; the message names the file.
    StorageError
        If another process records into the session, or the disk refuses. The recorded frames are
        intact in either case.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import import_frames, read_source, write_png
    >>> from acquisition.session import compact_session
    >>> write_png("card.png", np.full((64, 80), 700, np.uint16))
    >>> session = import_frames(read_source("card.png"), "session")
    >>> compaction = compact_session(session.folder)
    >>> compaction.compacted, compaction.bytes_after < compaction.bytes_before
    (1, True)
    """
    folder = Path(folder)
    lock = lock_session(folder)
    try:
        examination = examine(folder)
        session = examination.sound()
        return _Compactor(folder, examination.journal, session).run(on_progress)
    finally:
        filesystem.close(lock)


class _Compactor:
    def __init__(self, folder: Path, journal: Journal, session: Session) -> None:
        self._folder = folder
        self._old_journal = journal
        self._complete = session.complete or (
            not session.missing and _was_complete(folder, journal)
        )
        self._frames = recorded = session.recorded
        self._names = {Path(frame.line.file).name for frame in recorded}
        self._names |= {frame.path.name for frame in recorded}
        self._journal: JournalFile | None = None

    def run(self, on_progress: Progress) -> Compaction:
        """Compact every frame; at the end, even after an error, write COMPLETE again."""
        frames = self._frames
        after = [frame.bytes for frame in frames]
        compacted = 0
        try:
            for index, frame in enumerate(frames):
                if frame.path.name != Path(frame.line.file).name:
                    _check_file(frame, follow=False)
                    self._drop_original(frame)
                elif (size := self._compact(frame)) is not None:
                    after[index] = size
                    compacted += 1
                on_progress("compacting", index + 1, len(frames))
            self._finish()
        except BaseException as error:
            with suppress(DataError, StorageError):
                self._finish()
            if self._journal is None:
                error.add_note(f"{self._folder}: the compaction changed nothing")
            elif self._complete and not (self._folder / COMPLETE).is_file():
                error.add_note(f"{self._folder}: intact; compact it again to make it complete")
            raise
        finally:
            if self._journal is not None:
                self._journal.close()
        return Compaction(
            folder=self._folder,
            frames=len(frames),
            compacted=compacted,
            bytes_before=sum(frame.bytes for frame in frames),
            bytes_after=sum(after),
            complete=self._complete,
        )

    def _compact(self, frame: SessionFrame) -> int | None:
        """Compress one frame; return the size of its new file, None if it would not be smaller."""
        _check_file(frame)
        pixels = frame.read()
        data = deflate_tiff(pixels)
        if len(data) >= frame.bytes:
            return None
        new = self._free_path(frame.path)
        with published(new) as part:
            with disk(new, "write"):
                write_whole(part.descriptor, data)
            # Decode the file with the reader, which must return the same pixels.
            if not holds(part.path, pixels):
                raise _unlike(new)
            journal = self._open_journal()
        with disk(new, "read back"):
            if read_back(new) != data:
                raise _unlike(new)
        details = {
            "frame_seq": frame.line.seq,
            "file": f"{FRAMES}/{new.name}",
            "bytes": len(data),
            "file_sha256": sha256_of(data),
        }
        journal.append(EventLine, {"event": COMPACTED, "details": details})
        self._names.add(new.name)
        with disk(frame.path, "remove"):
            filesystem.unlink(frame.path)
        return len(data)

    def _drop_original(self, frame: SessionFrame) -> None:
        """Remove the old file of a frame whose compaction was interrupted after its event."""
        original = self._folder / frame.line.file
        if not os.path.lexists(original) or leaves(original, self._folder):
            return
        frame.read()
        with disk(original, "remove"):
            filesystem.unlink(original)

    def _free_path(self, path: Path) -> Path:
        """Return a path for a compressed file that no journal line names."""
        name, number = f"{path.stem}.z.tif", 1
        while name in self._names:
            number += 1
            name = f"{path.stem}.z{number}.tif"
        return path.with_name(name)

    def _open_journal(self) -> JournalFile:
        """Set COMPLETE aside, because the journal is about to grow, and open the journal."""
        if self._journal is not None:
            return self._journal
        mark, aside = self._folder / COMPLETE, self._folder / ASIDE
        if mark.exists():
            if leaves(aside.parent, self._folder):
                raise DataError(f"{aside.parent}: is a link that leaves the session")
            make_folder(aside.parent)
            with disk(mark, "set aside"):
                write_durably(aside, read_file(mark))
                filesystem.unlink(mark)
                sync_folder(self._folder)
        details = {"software_version": software_version(), "unrecorded": []}
        path = self._folder / JOURNAL
        self._journal = JournalFile.resume(path, self._old_journal, utc_now, details)
        return self._journal

    def _finish(self) -> None:
        """Write COMPLETE again if the session was complete."""
        if not self._complete:
            return
        if not (self._folder / COMPLETE).is_file():
            journal = self._open_journal()
            mark = completion_mark(journal.read_back())
            self._sweep()
            write_durably(self._folder / COMPLETE, mark)
        aside = self._folder / ASIDE
        # A read-only disk refuses even to remove a file that does not exist.
        if os.path.lexists(aside) and not leaves(aside.parent, self._folder):
            with disk(aside, "remove"):
                filesystem.unlink(aside)

    def _sweep(self) -> None:
        """Remove compressed files whose event was never written."""
        with disk(self._folder / FRAMES, "remove unused files"):
            for frame in self._frames:
                self._free_path(frame.path).unlink(missing_ok=True)


def _unlike(path: Path) -> StorageError:
    return StorageError(f"{path}: the data read back differ from those written: check the disk")


def _check_file(frame: SessionFrame, *, follow: bool = True) -> None:
    """Raise DataError unless the file of a frame is byte for byte the recorded one."""
    try:
        data = read_file(frame.path, follow=follow)
    except OSError as error:
        raise DataError(
            f"{frame.path}: cannot be read: {error.strerror}; restore or retake it"
        ) from error
    if len(data) != frame.bytes or sha256_of(data) != frame.file_sha256:
        raise DataError(
            f"{frame.path}: was changed since it was recorded; restore or retake it, then compact"
        )


def _was_complete(folder: Path, journal: Journal) -> bool:
    """Return whether a session without COMPLETE had one that a compaction set aside.

    It had one if the mark that was set aside is the hash of a first part of the journal that is
    followed by compactions only.
    """
    aside = folder / ASIDE
    if not aside.is_file() or leaves(aside, folder):
        return False
    with disk(aside, "read"):
        mark = read_file(aside)
    digest = hashlib.sha256()
    for number, piece in enumerate(journal.text.splitlines(keepends=True), 1):
        digest.update(piece)
        if mark.startswith(digest.hexdigest().encode("ascii")):
            return all(
                isinstance(line, EventLine) and line.event in (COMPACTED, REOPENED)
                for line in journal.lines[number:]
            )
    return False
