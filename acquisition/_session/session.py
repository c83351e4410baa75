"""Sessions on disk, read: what was recorded, what counts, and what is missing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from acquisition._errors import DataError, MissingPathError, StorageError
from acquisition._plan.planned_shot import PlannedShot
from acquisition._session.damage import Damage
from acquisition._session.journal import EventLine, Journal, StartLine, parse_journal
from acquisition._session.layout import (
    ASIDE,
    COMPLETE,
    FRAMES,
    JOURNAL,
    MANIFEST,
    WRITERS,
    completion_mark,
    is_session,
    leaves,
)
from acquisition._session.manifest import Manifest, parse_manifest
from acquisition._session.recorded import SetAsideFrame, recorded_frames
from acquisition._session.session_frame import SessionFrame
from acquisition._storage import is_part, sha256_of
from acquisition._values.camera_model import CameraModel
from acquisition._values.lights import Lights
from acquisition._values.noise_model import NoiseModel
from rig import MAX_TEXT_BYTES, MAX_TOML_BYTES, UnreadableError, read_bounded

# Of a million frames.
_MAX_JOURNAL_BYTES: Final = 1 << 30


@dataclass(frozen=True, eq=False)
class Session:
    """A recording.

    Parameters
    ----------
    folder
        Where it lies.
    manifest
        ``session.toml``.
    format_version
        Version of the format: the one it began with, or the one it was upgraded to.
    recorded
        Every frame of the journal, in order of recording, retaken and rejected ones too, but for
        those set aside.
    set_aside
        Frames that were found damaged, whose files are kept elsewhere.
    frames
        Those that count, one per shot: the last take that was not rejected, where it was not set
        aside.
    events
        Event lines in order.
    complete
        True where the recording was brought to its end.
    missing
        Planned shots without a frame that counts, but for those left out.
    left_out
        Planned shots without a frame that counts whose LED died: they are not demanded.
    warnings
        What was tolerated, one line each.
    lost_lines
        Why the journal seems to have lost its last lines; empty where it does not. It is one of
        the warnings.
    """

    folder: Path
    manifest: Manifest
    format_version: int
    recorded: tuple[SessionFrame, ...]
    set_aside: tuple[SetAsideFrame, ...]
    frames: tuple[SessionFrame, ...]
    events: tuple[EventLine, ...]
    complete: bool
    missing: tuple[PlannedShot, ...]
    left_out: tuple[PlannedShot, ...]
    warnings: tuple[str, ...]
    lost_lines: str = ""

    @classmethod
    def open(cls, folder: str | Path, *, damaged_frames: bool = False) -> Session:
        """Open a session, complete or not. Frames are read and checked when asked for.

        Parameters
        ----------
        folder
            The session.
        damaged_frames
            Open it also where single frames contradict their lines, or lines each other.

        Raises
        ------
        MissingPathError
            If the folder does not exist.
        DataError
            If it is no session, of another format version, or damaged.
        """
        return examine(Path(folder)).sound(but_for_frames=damaged_frames)

    def missing_without(self, frames: Iterable[SessionFrame]) -> tuple[PlannedShot, ...]:
        """Return the shots that would be missing if these frames were set aside, in plan order."""
        plan = self.manifest.plan
        gone = {frame.line.seq for frame in frames}
        kept = {frame.line.key for frame in self.frames if frame.line.seq not in gone}
        dead = _dead_leds(self.events, self.manifest)
        shots = () if plan is None else plan.shots()
        return tuple(s for s in shots if s.key not in kept and s.lit_led not in dead)

    @property
    def camera_model(self) -> CameraModel | None:
        """The camera as geometry, where known."""
        record = self.manifest.camera_model
        return None if record is None else record.value()

    @property
    def sensor(self) -> NoiseModel | None:
        """The sensor's noise model, where known."""
        record = self.manifest.sensor
        return None if record is None else record.value()

    @property
    def lights(self) -> Lights | None:
        """The calibrated lights stored with the session, where known."""
        record = self.manifest.lights
        return None if record is None else record.value()


@dataclass(frozen=True, eq=False)
class Examination:
    """A session as found, with everything wrong about it but the contents of its frame files.

    Parameters
    ----------
    session
        None where too little can be read to make one.
    journal
        As far as it can be trusted.
    names
        Every file in ``frames/`` that a line of the journal names.
    toml_sha256
        Hash of ``session.toml`` as it is.
    problems
        What is wrong with the session, a line each.
    flaws
        What is wrong with single frames, by the ``seq`` of their lines.
    """

    session: Session | None
    journal: Journal
    names: frozenset[str]
    toml_sha256: str
    problems: tuple[str, ...]
    flaws: Mapping[int, Damage]

    def sound(self, *, but_for_frames: bool = False) -> Session:
        """Return the session, or raise its first problem as a DataError.

        ``but_for_frames`` lets pass what is wrong with single frames: they can be set aside.
        """
        flaws = () if but_for_frames else self.flaws.values()
        problems = (*self.problems, *(flaw.text for flaw in flaws))
        if self.session is None or problems:
            raise DataError(problems[0])
        return self.session


def examine(folder: Path) -> Examination:
    """Read a session and collect what is wrong instead of stopping at the first.

    Raises
    ------
    MissingPathError
        If the folder does not exist.
    DataError
        If it is not a session, or cannot be read.
    """
    try:
        return _examine(folder)
    except (MissingPathError, StorageError):
        raise
    except OSError as error:
        where = error.filename or folder
        raise DataError(f"{where}: cannot be read: {error.strerror}; check the disk") from error


def _examine(folder: Path) -> Examination:
    if not folder.exists():
        raise MissingPathError(f"{folder}: no such folder")
    if not is_session(folder):
        raise DataError(f"{folder}: is not a session: it holds no {MANIFEST}")
    problems = list(_links(folder))
    warnings: list[str] = []
    manifest, toml_sha256 = _manifest(folder, problems)
    data, mark = _journal_and_mark(folder)
    journal = parse_journal(data or b"")
    _check_journal(folder, journal, toml_sha256, problems, warnings)
    complete = _completion(folder, mark, data, journal, problems, warnings)
    if manifest is None:
        return Examination(None, journal, frozenset(), toml_sha256, tuple(problems), {})
    planned = () if manifest.plan is None else manifest.plan.shots()
    recorded = recorded_frames(folder, manifest, planned, journal)
    problems += recorded.problems
    counted = recorded.counted()
    events = tuple(line for line in journal.lines if isinstance(line, EventLine))
    dead = _dead_leds(events, manifest)
    absent = [shot for shot in planned if shot.key not in counted]
    missing = tuple(shot for shot in absent if shot.lit_led not in dead)
    if complete and missing and journal.damage is None:
        problems.append(
            f"{folder / COMPLETE}: is there although {len(missing)} planned frames are not, "
            f"first {missing[0].file}"
        )
    lost_lines = ""
    if not complete and journal.lines and journal.damage is None:
        hint, many = _unrecorded_hint(folder, recorded.names)
        warnings += [hint] if hint else []
        lost_lines = hint if many else ""
    session = Session(
        folder=folder,
        manifest=manifest,
        format_version=recorded.version,
        recorded=tuple(recorded.frames.values()),
        set_aside=tuple(recorded.set_aside.values()),
        frames=tuple(counted.values()),
        events=events,
        complete=complete,
        missing=missing,
        left_out=tuple(shot for shot in absent if shot.lit_led in dead),
        warnings=tuple(warnings),
        lost_lines=lost_lines,
    )
    names = frozenset(recorded.names)
    return Examination(session, journal, names, toml_sha256, tuple(problems), recorded.flaws)


def _dead_leds(events: Iterable[EventLine], manifest: Manifest) -> frozenset[int]:
    """Return the LEDs whose missing shots are not demanded."""
    # Version 1 knows no such event.
    tells = events if manifest.format_version > 1 else ()
    return frozenset[int]().union(*(line.left_out for line in tells))


def _links(folder: Path) -> Iterator[str]:
    """Tell of parts of the session that lie elsewhere: what is there is not what was recorded."""
    for path in (folder / name for name in (MANIFEST, JOURNAL, COMPLETE, FRAMES)):
        if path.is_symlink() and leaves(path, folder):
            yield f"{path}: is a link that leaves the session; put what it names in its place"


def _unrecorded_hint(folder: Path, recorded: set[str]) -> tuple[str, bool]:
    """Tell of files without a line, and whether they are more than an interruption explains."""
    files = [path.name for path in _names(folder / FRAMES) if path.name not in recorded]
    if not files:
        return "", False
    many = len(files) > WRITERS
    explained = "written when the recording was interrupted; such a file does not count"
    lost = (
        f"an interruption leaves {WRITERS} at most, so the journal may have lost its last lines: "
        f"restore {JOURNAL} and {COMPLETE} from a copy before going on; without their lines the "
        "files do not count"
    )
    return (
        f"{folder / FRAMES}: {_counted(len(files), 'file')} without a line in the journal, first "
        f"{files[0]}: {lost if many else explained}"
    ), many


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _bytes(path: Path, most_bytes: int) -> bytes | None:
    """Return a file's bytes, None where there is none."""
    try:
        return read_bounded(path, most_bytes)
    except FileNotFoundError:
        return None
    except UnreadableError as error:
        raise DataError(f"{path}: {error}") from error


def _journal_and_mark(folder: Path) -> tuple[bytes | None, bytes | None]:
    """Return the journal and COMPLETE as they were together: somebody may be writing just now."""
    data = _bytes(folder / JOURNAL, _MAX_JOURNAL_BYTES)
    while True:
        mark = _bytes(folder / COMPLETE, MAX_TEXT_BYTES)
        again = _bytes(folder / JOURNAL, _MAX_JOURNAL_BYTES)
        if again == data:
            return data, mark
        data = again


def _manifest(folder: Path, problems: list[str]) -> tuple[Manifest | None, str]:
    path = folder / MANIFEST
    data = _bytes(path, MAX_TOML_BYTES)
    if data is None:
        problems.append(f"{path}: is missing; restore it")
        return None, ""
    try:
        return parse_manifest(data, path), sha256_of(data)
    except DataError as error:
        problems.append(str(error))
        return None, sha256_of(data)


def _check_journal(
    folder: Path, journal: Journal, toml_sha256: str, problems: list[str], warnings: list[str]
) -> None:
    path = folder / JOURNAL
    if journal.damage is not None:
        problems.append(f"{path}: {journal.damage}; restore the file, its frames may be whole")
    if journal.torn:
        warnings.append(
            f"{path}: the last line was cut off while being written ({len(journal.torn)} bytes); "
            "it does not count"
        )
    if journal.unterminated:
        warnings.append(f"{path}: the last line lacks its newline but is whole; it counts")
    if journal.lines:
        start = journal.lines[0]
        if isinstance(start, StartLine) and toml_sha256 != start.session_toml_sha256:
            problems.append(
                f"{folder / MANIFEST}: is not the one the journal began with; restore it"
            )
    elif journal.damage is None:
        # Killed between the two first writes: nothing was recorded yet.
        if (folder / COMPLETE).exists() or any(_names(folder / FRAMES)):
            problems.append(f"{path}: is missing or empty though frames are there; restore it")
        else:
            warnings.append(f"{path}: the recording ended before its first line")


def _completion(
    folder: Path,
    mark: bytes | None,
    data: bytes | None,
    journal: Journal,
    problems: list[str],
    warnings: list[str],
) -> bool:
    path = folder / COMPLETE
    if mark is None:
        if (folder / ASIDE).is_file():
            warnings.append(f"{folder}: a compaction was cut off: run `capture compact` on it")
        return False
    if mark != completion_mark(data or b""):
        problems.append(
            f"{path}: does not name the journal beside it; one of the two was changed, restore it"
        )
    elif journal.torn or journal.unterminated:
        problems.append(f"{folder / JOURNAL}: ends in a part of a line though it was completed")
    return True


def _names(folder: Path) -> Iterator[Path]:
    """Yield the files of a folder that are not rests of unfinished writes, if it exists."""
    if folder.is_dir():
        yield from sorted(path for path in folder.iterdir() if not is_part(path))
