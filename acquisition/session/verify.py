"""Verification of a session: all hashes, all files, and the journal against the plan."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from acquisition.files.storage import is_hidden
from acquisition.session.frame_check import frame_damage
from acquisition.session.journal import FrameLine
from acquisition.session.layout import FRAMES
from acquisition.session.session import examine
from rig import Notice, pluralize


@dataclass(frozen=True)
class Verification:
    """Result of a verification.

    Parameters
    ----------
    folder
        The session.
    complete
        True if the recording was completed. A session can be intact and incomplete.
    problems
        One line for each difference from the recording, naming the file.
    warnings
        One notice for each trace of an interruption that has not damaged a recorded frame.
    frames
        Number of frame lines.
    events
        Number of event lines.
    missing
        File names of planned shots that are not recorded.
    left_out
        File names of planned shots that are not recorded and not required because their LED is
        dead.
    damaged
        File names of the frames among the problems; `resume` can retake their shots.
    set_aside
        File names of frames that were damaged earlier; they do not count and are not checked.
    bytes
        Size of all frame files.
    """

    folder: Path
    complete: bool
    problems: tuple[str, ...]
    warnings: tuple[Notice, ...]
    frames: int
    events: int
    missing: tuple[str, ...]
    left_out: tuple[str, ...]
    damaged: tuple[str, ...]
    set_aside: tuple[str, ...]
    bytes: int

    def __repr__(self) -> str:
        state = "complete" if self.complete else f"incomplete, {len(self.missing)} missing"
        counts = f"{pluralize(self.frames, 'frame')}, {pluralize(len(self.problems), 'problem')}"
        return f"Verification({self.folder}, {state}, {counts})"

    @property
    def ok(self) -> bool:
        """Whether the complete recording is unchanged."""
        return not self.problems


def verify_session(folder: str | Path) -> Verification:
    """Verify a session: hash chain, ``session.toml``, COMPLETE and every frame file.

    Damage is reported, not raised.

    Parameters
    ----------
    folder
        The session, complete or not.

    Returns
    -------
    Verification
        Problems in the order session.toml, journal, frames.

    Raises
    ------
    MissingPathError
        If the folder does not exist.
    DataError
        If it is not a session.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import import_frames, read_source, verify_session, write_png
    >>> write_png("card.png", np.full((4, 5), 700, np.uint16))
    >>> session = import_frames(read_source("card.png"), "session")
    >>> verify_session(session.folder).ok
    True
    """
    folder = Path(folder)
    examination = examine(folder)
    session = examination.session
    if session is None:
        return Verification(folder, False, examination.problems, (), 0, 0, (), (), (), (), 0)
    found: list[str | Notice] = [*examination.problems, *session.warnings]
    damaged = []
    for frame in session.recorded:
        camera = session.manifest.camera
        damage = examination.flaws.get(frame.line.seq) or frame_damage(frame, camera)
        if damage is not None:
            damaged.append(frame.path.name)
            found.append(damage.text)
    # Lines after a damaged one cannot be trusted, so later files cannot be checked.
    if examination.journal.damage is None:
        found += _check_files(folder, examination.names, session.complete)
    return Verification(
        folder=folder,
        complete=session.complete,
        problems=tuple(dict.fromkeys(one for one in found if isinstance(one, str))),
        warnings=tuple(one for one in found if isinstance(one, Notice)),
        frames=sum(isinstance(line, FrameLine) for line in examination.journal.lines),
        events=len(session.events),
        missing=tuple(shot.file for shot in session.missing),
        left_out=tuple(shot.file for shot in session.left_out),
        damaged=tuple(damaged),
        set_aside=tuple(one.frame.path.name for one in session.set_aside),
        bytes=sum(frame.bytes for frame in session.recorded),
    )


def _check_files(folder: Path, recorded: frozenset[str], complete: bool) -> Iterator[str | Notice]:
    frames = folder / FRAMES
    for path in sorted(frames.iterdir()) if frames.is_dir() else ():
        if path.name in recorded:
            continue
        if is_hidden(path):
            if not path.is_dir():
                text = "was left by an unfinished write; it can be deleted"
                yield Notice("part-file-left", text, str(path), "info")
        elif complete:
            yield (
                f"{path}: is in no line of the journal; if lines are missing there, restore the "
                "journal"
            )
