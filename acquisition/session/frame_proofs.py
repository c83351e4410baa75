"""Checks of recorded frames while a session is being written."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final

from acquisition._errors import DataError
from acquisition.session.frame_check import frame_damage
from acquisition.session.manifest import CameraRecord
from acquisition.session.session import Examination, examine
from acquisition.session.session_frame import Damage, SessionFrame
from rig import Progress, no_progress
from rig.host import threads

CHECKING: Final = "checking recorded frames"

# Inode, size, and times of the last change of the content and of the inode.
_Signature = tuple[int, int, int, int]


class FrameProofs:
    """Reads back the frames that earlier processes recorded; safe to use from several threads.

    A frame that this process wrote is not read again: its hashes were computed from the data that
    were written and flushed, and reading would return the cached memory, not the data on the disk.
    But inode, size and times of every file are noted when it is written or read, and a file that
    has changed since is read once more.

    Parameters
    ----------
    camera
        Camera record of the session.
    earlier
        Frames recorded by earlier processes.
    """

    def __init__(self, camera: CameraRecord, earlier: Iterable[SessionFrame] = ()) -> None:
        self._camera = camera
        self._frames = {frame.line.seq: frame for frame in earlier}
        self._unread = list(reversed(self._frames))
        self._total = len(self._unread)
        self._done = 0
        self._intact: dict[int, _Signature | None] = {}
        self._damage: dict[int, Damage] = {}
        self._lock = threads.Lock()

    @property
    def checked(self) -> tuple[int, int]:
        """Number of earlier frames read back so far, and their total."""
        with self._lock:
            return self._done, self._total

    @property
    def damage(self) -> tuple[Damage, ...]:
        """Damaged frames found so far, in order of recording."""
        with self._lock:
            return tuple(self._damage[seq] for seq in sorted(self._damage))

    def check_undamaged(self) -> None:
        """Raise DataError if a frame that was read back is damaged."""
        if damage := self.damage:
            more = f"; {len(damage)} frames are damaged" if len(damage) > 1 else ""
            raise DataError(f"{damage[0].text}{more}")

    def written(self, frame: SessionFrame) -> None:
        """Note a frame that this process has just stored."""
        with self._lock:
            self._frames[frame.line.seq] = frame
            self._intact[frame.line.seq] = _signature(frame.path)

    def forget(self, frames: Iterable[SessionFrame]) -> None:
        """Remove frames that were read back and are now set aside."""
        with self._lock:
            for seq in (frame.line.seq for frame in frames):
                for by_seq in (self._frames, self._intact, self._damage):
                    by_seq.pop(seq, None)

    def check_next(self) -> bool:
        """Read back one more earlier frame; return False if none is left."""
        with self._lock:
            if not self._unread:
                return False
            frame = self._frames[self._unread.pop()]
        self._check(frame)
        with self._lock:
            self._done += 1
        return True

    def check_all(self, on_progress: Progress = no_progress) -> tuple[Damage, ...]:
        """Read back every unread or changed frame; return the damaged ones.

        ``on_progress`` receives the stage `CHECKING`, one step per earlier frame.
        """
        while self.check_next():
            on_progress(CHECKING, *self.checked)
        with self._lock:
            frames = list(self._frames.values())
        for frame in frames:
            now = _signature(frame.path)
            if now is None or now != self._intact.get(frame.line.seq):
                self._check(frame)
        return self.damage

    def _check(self, frame: SessionFrame) -> None:
        seq = frame.line.seq
        before = _signature(frame.path)
        damage = frame_damage(frame, self._camera)
        with self._lock:
            self._intact.pop(seq, None)
            self._damage.pop(seq, None)
            if damage is None:
                self._intact[seq] = before
            else:
                self._damage[seq] = damage


def _signature(path: Path) -> _Signature | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns


def damaged_frames(
    folder: str | Path, *, on_progress: Progress = no_progress
) -> tuple[Damage, ...]:
    """Read back every frame of a session and return the damaged ones; nothing is changed.

    Parameters
    ----------
    folder
        The session, complete or not.
    on_progress
        Receives the stage ``checking recorded frames``, one step per frame.

    Returns
    -------
    tuple of Damage
        Frames that are lost, changed, or contradicted by their own or by other lines, in order of
        recording. `resume` can set them aside and take their shots again.

    Raises
    ------
    MissingPathError
        If the folder does not exist.
    DataError
        If it is not a session, or has damage other than single frames.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import import_frames, read_source, write_png
    >>> from acquisition.session import damaged_frames
    >>> write_png("card.png", np.full((4, 5), 700, np.uint16))
    >>> session = import_frames(read_source("card.png"), "session")
    >>> session.frames[0].path.unlink()
    >>> [damage.frame for damage in damaged_frames("session")]
    [SessionFrame(L00_E0.tif, light, LED 0, shape (4, 5))]
    """
    examination = examine(Path(folder))
    session = examination.sound(but_for_frames=True)
    proofs = FrameProofs(session.manifest.camera, session.recorded)
    return damaged_frames_of(examination, proofs, on_progress)


def damaged_frames_of(
    examination: Examination, proofs: FrameProofs, on_progress: Progress
) -> tuple[Damage, ...]:
    """Return the damaged frames of an examined session."""
    by_seq = {one.frame.line.seq: one for one in proofs.check_all(on_progress)}
    by_seq |= dict(examination.flaws)
    return tuple(by_seq[seq] for seq in sorted(by_seq))
