"""Sessions on disk, read: what was recorded, what counts, and what is missing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from acquisition._errors import DataError, MissingPathError
from acquisition._plan.planned_shot import PlannedShot
from acquisition._session.journal import EventLine, Journal, StartLine, parse_journal
from acquisition._session.layout import (
    ASIDE,
    COMPLETE,
    FRAMES,
    JOURNAL,
    MANIFEST,
    completion_mark,
    is_session,
)
from acquisition._session.manifest import Manifest, parse_manifest
from acquisition._session.recorded import recorded_frames
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
    recorded
        Every frame of the journal, in order of recording, retaken and rejected ones too.
    frames
        Those that count, one per shot: the last whole take that was not rejected.
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
    """

    folder: Path
    manifest: Manifest
    recorded: tuple[SessionFrame, ...]
    frames: tuple[SessionFrame, ...]
    events: tuple[EventLine, ...]
    complete: bool
    missing: tuple[PlannedShot, ...]
    left_out: tuple[PlannedShot, ...]
    warnings: tuple[str, ...]

    @classmethod
    def open(cls, folder: str | Path) -> Session:
        """Open a session, complete or not. Frames are read and checked when asked for.

        Raises
        ------
        MissingPathError
            If the folder does not exist.
        DataError
            If it is no session, of another format version, or damaged.
        """
        return examine(Path(folder)).sound()

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

    ``session`` is None where too little can be read to make one; ``toml_sha256`` is the hash of
    ``session.toml`` as it is.
    """

    session: Session | None
    journal: Journal
    toml_sha256: str
    problems: tuple[str, ...]

    def sound(self) -> Session:
        """Return the session, or raise its first problem as a DataError."""
        if self.session is None or self.problems:
            raise DataError(self.problems[0])
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
    except OSError as error:
        where = error.filename or folder
        raise DataError(f"{where}: cannot be read: {error.strerror}; check the disk") from error


def _examine(folder: Path) -> Examination:
    if not folder.exists():
        raise MissingPathError(f"{folder}: no such folder")
    if not is_session(folder):
        raise DataError(f"{folder}: is not a session: it holds no {MANIFEST}")
    problems: list[str] = []
    warnings: list[str] = []
    manifest, toml_sha256 = _manifest(folder, problems)
    data, mark = _journal_and_mark(folder)
    journal = parse_journal(data or b"")
    _check_journal(folder, journal, toml_sha256, problems, warnings)
    complete = _completion(folder, mark, data, journal, problems, warnings)
    if manifest is None:
        return Examination(None, journal, toml_sha256, tuple(problems))
    recorded = recorded_frames(folder, manifest, journal, problems)
    counted = {frame.line.key: frame for frame in recorded if frame.line.status == "ok"}
    planned = manifest.plan.shots() if manifest.plan is not None else ()
    if manifest.plan is not None:
        keys = {shot.key for shot in planned}
        problems += [
            f"{frame.path}: is not in the plan of {folder / MANIFEST}"
            for frame in recorded
            if frame.line.key not in keys
        ]
    events = tuple(line for line in journal.lines if isinstance(line, EventLine))
    # Version 1 knows no such event.
    tells = events if manifest.format_version > 1 else ()
    dead = frozenset[int]().union(*(line.left_out for line in tells))
    absent = [shot for shot in planned if shot.key not in counted]
    missing = tuple(shot for shot in absent if shot.lit_led not in dead)
    if complete and missing and journal.damage is None:
        problems.append(
            f"{folder / COMPLETE}: is there although {len(missing)} planned frames are not, "
            f"first {missing[0].file}"
        )
    session = Session(
        folder=folder,
        manifest=manifest,
        recorded=recorded,
        frames=tuple(counted.values()),
        events=events,
        complete=complete,
        missing=missing,
        left_out=tuple(shot for shot in absent if shot.lit_led in dead),
        warnings=tuple(warnings),
    )
    return Examination(session, journal, toml_sha256, tuple(problems))


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
