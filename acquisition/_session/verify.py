"""Whether a session is still what was recorded: every hash, every file, plan against journal."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from acquisition._errors import DataError
from acquisition._session.journal import FrameLine
from acquisition._session.layout import FRAMES
from acquisition._session.session import examine
from acquisition._session.session_frame import SessionFrame
from acquisition._storage import is_part, read_file, sha256_of


@dataclass(frozen=True)
class Verification:
    """What a verification found.

    Parameters
    ----------
    folder
        The session.
    complete
        True where the recording was brought to its end. A session can be whole and incomplete.
    problems
        One line for each thing that is not as recorded, naming the file.
    warnings
        One line for each thing that an interruption explains and that costs no recorded frame.
    frames
        Frame lines checked.
    events
        Event lines.
    missing
        Files of planned shots that are not recorded.
    left_out
        Files of planned shots that are not recorded and not demanded, as their LED died.
    bytes
        Size of all frame files read.
    """

    folder: Path
    complete: bool
    problems: tuple[str, ...]
    warnings: tuple[str, ...]
    frames: int
    events: int
    missing: tuple[str, ...]
    left_out: tuple[str, ...]
    bytes: int

    @property
    def ok(self) -> bool:
        """True where everything recorded is unchanged."""
        return not self.problems


def verify_session(folder: str | Path) -> Verification:
    """Check a session against itself: hash chain, ``session.toml``, COMPLETE, every frame file.

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
    """
    folder = Path(folder)
    found = examine(folder)
    problems = list(found.problems)
    session = found.session
    if session is None:
        return Verification(folder, False, tuple(problems), (), 0, 0, (), (), 0)
    warnings = list(session.warnings)
    size = 0
    for frame in session.recorded:
        problem, read = _check_frame(frame)
        size += read
        if problem is not None:
            problems.append(problem)
    # After a damaged line the journal says nothing about later files.
    if found.journal.damage is None:
        _check_files(folder, session.recorded, session.complete, problems, warnings)
    return Verification(
        folder=folder,
        complete=session.complete,
        problems=tuple(dict.fromkeys(problems)),
        warnings=tuple(warnings),
        frames=sum(isinstance(line, FrameLine) for line in found.journal.lines),
        events=len(session.events),
        missing=tuple(shot.file for shot in session.missing),
        left_out=tuple(shot.file for shot in session.left_out),
        bytes=size,
    )


def _check_frame(frame: SessionFrame) -> tuple[str | None, int]:
    """Return what is wrong with a frame's file, and how many bytes were read."""
    try:
        data = read_file(frame.path)
    except OSError as error:
        return f"{frame.path}: cannot be read: {error.strerror}; restore or retake it", 0
    if len(data) != frame.bytes:
        return (
            f"{frame.path}: has {len(data)} bytes, {frame.bytes} were recorded; "
            "restore or retake it"
        ), len(data)
    if sha256_of(data) != frame.file_sha256:
        return f"{frame.path}: was changed since it was recorded; restore or retake it", len(data)
    try:
        frame.read()
    except DataError as error:
        return str(error), len(data)
    return None, len(data)


def _check_files(
    folder: Path,
    recorded: tuple[SessionFrame, ...],
    complete: bool,
    problems: list[str],
    warnings: list[str],
) -> None:
    known = {frame.path.name for frame in recorded}
    known |= {Path(frame.line.file).name for frame in recorded}
    frames = folder / FRAMES
    for path in sorted(frames.iterdir()) if frames.is_dir() else ():
        if path.name in known:
            continue
        if is_part(path):
            if not path.is_dir():
                warnings.append(f"{path}: is the rest of a write that never finished; it may go")
        elif complete:
            problems.append(
                f"{path}: is in no line of the journal; restore the journal if that is not whole"
            )
        else:
            warnings.append(f"{path}: was written but not recorded; it does not count")
