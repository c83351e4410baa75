"""Whether a session is still what was recorded: every hash, every file, plan against journal."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from acquisition._session.frame_damage import frame_damage
from acquisition._session.journal import FrameLine
from acquisition._session.layout import FRAMES
from acquisition._session.session import examine
from acquisition._storage import is_part


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
        Frame lines.
    events
        Event lines.
    missing
        Files of planned shots that are not recorded.
    left_out
        Files of planned shots that are not recorded and not demanded, as their LED died.
    damaged
        Files of the frames that are among the problems; `resume` can retake their shots.
    set_aside
        Files of frames that were damaged before, do not count, and are not checked.
    bytes
        Size of all frame files.
    """

    folder: Path
    complete: bool
    problems: tuple[str, ...]
    warnings: tuple[str, ...]
    frames: int
    events: int
    missing: tuple[str, ...]
    left_out: tuple[str, ...]
    damaged: tuple[str, ...]
    set_aside: tuple[str, ...]
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
    session = found.session
    if session is None:
        return Verification(folder, False, found.problems, (), 0, 0, (), (), (), (), 0)
    problems = list(found.problems)
    warnings = list(session.warnings)
    damaged = []
    for frame in session.recorded:
        camera = session.manifest.camera
        damage = found.flaws.get(frame.line.seq) or frame_damage(frame, camera)
        if damage is not None:
            damaged.append(frame.path.name)
            problems.append(damage.text)
    # After a damaged line the journal says nothing about later files.
    if found.journal.damage is None:
        _check_files(folder, found.names, session.complete, problems, warnings)
    return Verification(
        folder=folder,
        complete=session.complete,
        problems=tuple(dict.fromkeys(problems)),
        warnings=tuple(warnings),
        frames=sum(isinstance(line, FrameLine) for line in found.journal.lines),
        events=len(session.events),
        missing=tuple(shot.file for shot in session.missing),
        left_out=tuple(shot.file for shot in session.left_out),
        damaged=tuple(damaged),
        set_aside=tuple(one.frame.path.name for one in session.set_aside),
        bytes=sum(frame.bytes for frame in session.recorded),
    )


def _check_files(
    folder: Path,
    known: frozenset[str],
    complete: bool,
    problems: list[str],
    warnings: list[str],
) -> None:
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
